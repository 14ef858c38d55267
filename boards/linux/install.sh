#!/bin/sh
# Installs Lookout from this folder on a system without Debian packages, or takes it off again.
# Usage: sudo ./install.sh PROGRAM      PROGRAM is the built `lookout` for this machine
#        sudo ./install.sh --remove     takes off all but the settings in /etc/lookout
# DESTDIR=DIR installs below DIR and starts nothing.
set -eu
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
root=${DESTDIR:-}

fail() {
  printf 'install.sh: %s\n' "$1" >&2
  exit 1
}

# On a system that runs, what is not told is not seen.
tell() {
  [ -n "$root" ] || "$@" || printf 'install.sh: %s did not work; after a restart all is in place\n' "$*" >&2
}

[ $# -eq 1 ] || fail "one argument: the program to install, or --remove"
[ -n "$root" ] || [ "$(id -u)" -eq 0 ] || fail "needs root: sudo $0 $1"

if [ "$1" = --remove ]; then
  tell systemctl disable --now lookout.service
  rm -f "$root/usr/bin/lookout" "$root/etc/systemd/system/lookout.service" \
    "$root/etc/udev/rules.d/70-lookout.rules"
  tell systemctl daemon-reload
  tell udevadm control --reload-rules
  exit 0
fi

[ -x "$1" ] || fail "$1: no such program; build it with 'cargo build --release'"
[ -n "$root" ] || "$1" --version >/dev/null || fail "$1: does not run on this machine; was it built for another?"
board=companion
if [ -r /proc/device-tree/model ]; then
  case $(tr -d '\0' </proc/device-tree/model) in
    *Raspberry*) board=raspberry-pi ;;
    *Jetson* | *NVIDIA*) board=jetson ;;
  esac
fi
install -D -m 755 "$1" "$root/usr/bin/lookout"
install -D -m 644 "$here/lookout.service" "$root/etc/systemd/system/lookout.service"
install -D -m 644 "$here/70-lookout.rules" "$root/etc/udev/rules.d/70-lookout.rules"
if [ -e "$root/etc/lookout/lookout.toml" ]; then
  echo "kept: /etc/lookout/lookout.toml"
else
  install -D -m 644 "$here/$board.toml" "$root/etc/lookout/lookout.toml"
  # A token may be in it: for root and for the service, which is in this group.
  [ -n "$root" ] || { chgrp dialout /etc/lookout/lookout.toml && chmod 640 /etc/lookout/lookout.toml; }
  echo "settings for $board: /etc/lookout/lookout.toml"
fi
tell systemctl daemon-reload
tell udevadm control --reload-rules
tell udevadm trigger --subsystem-match=video4linux --subsystem-match=tty
echo "look at /etc/lookout/lookout.toml, then: systemctl enable --now lookout"
