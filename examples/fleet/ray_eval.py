#!/usr/bin/env python3
"""Evaluates the clips of a manifest on a Ray cluster, then prints the report of all of them.

    pip install ray
    lookout manifest /data/flights --out flights.csv
    python3 ray_eval.py flights.csv --out /shared/run               # this machine, or: --address auto for a cluster
    python3 ray_eval.py flights.csv --out /shared/run -- --tracks   # arguments behind -- go to `lookout eval`

A task is one clip and starts the program, which must be on every machine; the manifest's files and the folder of the run must
be reachable from all of them under the same path. A task whose worker is lost, or whose machine fails, is tried again; what
the program says is hopeless (status 42) is not. Started again, it goes on where it was.
"""

import argparse
import csv
import os
import subprocess
import sys
import time

import ray

# The same must not be tried again: a clip that cannot be decoded, a manifest that makes no sense.
HOPELESS = 42


class Again(Exception):
    """A failure that may be of the machine."""


@ray.remote(num_cpus=1, max_retries=3, retry_exceptions=[Again])
def evaluate(lookout, arguments, index, count):
    """Measures one clip; gives the worker's number and, where it is hopeless, why."""
    command = [lookout, "eval", *arguments, "--shard", f"{index}/{count}", "--jobs", "1"]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if done.returncode not in (0, HOPELESS):
        raise Again(done.stderr.strip() or f"status {done.returncode}")
    return os.getpid(), done.stderr.strip() if done.returncode == HOPELESS else ""


def length(row, manifest):
    """Bytes of a clip's video, to begin with the longest; 0 where they are not known."""
    path = os.path.join(os.path.dirname(manifest), row["path"])
    return os.path.getsize(path) if os.path.isfile(path) else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("manifest")
    parser.add_argument("--out", required=True, help="folder of the run, shared by all machines")
    parser.add_argument("--lookout", default="lookout", help="the program, on every machine")
    parser.add_argument("--address", help="of a running cluster; auto finds it")
    parser.add_argument("--workers", type=int, help="clips at a time on this machine, without --address")
    parser.add_argument("arguments", nargs="*", help="behind --: more arguments of lookout eval")
    args = parser.parse_args()
    # Standard output is the report's; Ray tells of lost workers there.
    report = os.dup(1)
    os.dup2(2, 1)
    manifest, out = os.path.abspath(args.manifest), os.path.abspath(args.out)
    with open(manifest, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    ray.init(address=args.address, num_cpus=args.workers, include_dashboard=False, log_to_driver=False)
    arguments = ["--manifest", manifest, "--out", out, *args.arguments]
    longest_first = sorted(range(len(rows)), key=lambda index: -length(rows[index], manifest))
    waiting = {evaluate.remote(args.lookout, arguments, index, len(rows)): index for index in longest_first}
    started, bad = time.monotonic(), []
    while waiting:
        for task in ray.wait(list(waiting))[0]:
            clip = rows[waiting.pop(task)]["clip"]
            try:
                worker, hopeless = ray.get(task)
            except ray.exceptions.RayError as error:
                worker, hopeless = "-", str(error).strip().splitlines()[-1]
            bad += [f"{clip}: {hopeless}"] if hopeless else []
            done = len(rows) - len(waiting)
            hours = (time.monotonic() - started) / 3600
            print(f"{done} of {len(rows)}: {clip}, worker {worker}, {done / hours:.0f} clips an hour", flush=True,
                  file=sys.stderr)
    print(*bad, sep="\n", end="\n" if bad else "", file=sys.stderr)
    merged = subprocess.run([args.lookout, "merge", out], stdout=report)
    sys.exit(merged.returncode)


if __name__ == "__main__":
    main()
