#!/usr/bin/python3
"""An RTSP server for tests: H.264 of a moving test picture at rtsp://127.0.0.1:PORT/cam, until it is killed.

Usage: server.py PORT [RATE]. Needs Debian's python3-gi, gir1.2-gst-rtsp-server-1.0, gstreamer1.0-plugins-{base,good,ugly}.
Ends with status 77 where one of them is missing.
"""
import sys

try:
    import gi

    gi.require_version("Gst", "1.0")
    gi.require_version("GstRtspServer", "1.0")
    from gi.repository import GLib, Gst, GstRtspServer
except (ImportError, ValueError) as error:
    sys.exit(print(f"missing: {error}", flush=True) or 77)

Gst.init(None)
for element in ("videotestsrc", "x264enc", "rtph264pay"):
    if Gst.ElementFactory.find(element) is None:
        sys.exit(print(f"missing: {element}", flush=True) or 77)
rate = int(sys.argv[2]) if len(sys.argv) > 2 else 20
factory = GstRtspServer.RTSPMediaFactory.new()
factory.set_launch(
    f"( videotestsrc is-live=true pattern=smpte100 horizontal-speed=2 ! video/x-raw,format=I420,width=640,height=360,framerate={rate}/1 "
    f"! x264enc tune=zerolatency speed-preset=ultrafast bitrate=1500 key-int-max={rate} ! rtph264pay name=pay0 pt=96 config-interval=1 )"
)
factory.set_shared(True)
server = GstRtspServer.RTSPServer.new()
server.set_address("127.0.0.1")
server.set_service(sys.argv[1])
server.get_mount_points().add_factory("/cam", factory)
if server.attach(None) == 0:
    sys.exit(f"port {sys.argv[1]} is taken")
print("ready", flush=True)
GLib.MainLoop().run()
