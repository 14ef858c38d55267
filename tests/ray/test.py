"""Runs examples/fleet on this machine: test.py LOOKOUT [CLIPS].

40 simulated clips on two Ray workers, of which one is killed in the middle; the report must be that of `lookout eval`. The
files for Slurm and Kubernetes are started as those engines would, three tasks each.
"""

import os
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import time

import yaml

EXAMPLES = pathlib.Path(__file__).resolve().parents[2] / "examples" / "fleet"
CLIPS = int(sys.argv[2]) if len(sys.argv) > 2 else 40
KINDS = ["crossing", "hover", "receding", "none"]


def run(*command, **more):
    done = subprocess.run(command, capture_output=True, text=True, **more)
    assert done.returncode == 0, f"{command}: status {done.returncode}\n{done.stderr}"
    return done.stdout


def parent(pid):
    return int(re.search(r"PPid:\s+(\d+)", pathlib.Path(f"/proc/{pid}/status").read_text()).group(1))


def ours(pid):
    """Whether a process descends from this one."""
    while pid > 1:
        if pid == os.getpid():
            return True
        pid = parent(pid)
    return False


def ray_loses_a_worker(lookout, folder, expected):
    command = [sys.executable, EXAMPLES / "ray_eval.py", "m.csv", "--out", "ray", "--lookout", lookout, "--workers", "2"]
    environment = dict(os.environ, RAY_TMPDIR=str(folder / "r"), RAY_USAGE_STATS_ENABLED="0")
    child = subprocess.Popen(command, cwd=folder, env=environment, text=True,
                             stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    workers, rates, killed = set(), [], None
    for line in child.stderr:
        found = re.match(r"(\d+) of (\d+): .*, worker (\d+), (\d+) clips an hour", line)
        if not found:
            continue
        done, worker = int(found[1]), int(found[3])
        workers.add(worker)
        rates.append(int(found[4]))
        # A number that a worker of ours said, and that is still one: no other process is touched.
        if done >= CLIPS // 4 and killed is None and pathlib.Path(f"/proc/{worker}").exists() and ours(worker):
            killed = worker
            os.kill(worker, signal.SIGKILL)
    report = child.stdout.read()
    assert child.wait() == 0, report
    assert killed is not None and len(workers) >= 3, (killed, workers)
    assert report == expected, report
    print(f"Ray: {CLIPS} clips, workers {len(workers)}, one killed; the report is that of one machine; {rates[-1]} clips an hour")


def engines(lookout, folder, expected):
    """The script for Slurm and the command of the Kubernetes job, with what these engines put into the environment."""
    tools = folder / "tools"
    tools.mkdir()
    (tools / "lookout").symlink_to(lookout)
    for name, text in [("srun", 'exec "$@"'), ("scontrol", "exit 1")]:
        (tools / name).write_text(f"#!/bin/sh\n{text}\n")
        (tools / name).chmod(0o755)
    path = f"{tools}:{os.environ['PATH']}"
    for task in range(1, 4):
        array = {"ID": task, "COUNT": 3, "MIN": 1, "MAX": 3}
        variables = {f"SLURM_ARRAY_TASK_{name}": str(value) for name, value in array.items()}
        run(EXAMPLES / "slurm_eval.sh", "m.csv", "slurm", cwd=folder, env=dict(os.environ, PATH=path, **variables))
    assert run(lookout, "merge", "slurm", cwd=folder) == expected
    job = yaml.safe_load((EXAMPLES / "kubernetes_job.yaml").read_text())
    spec = job["spec"]
    container = spec["template"]["spec"]["containers"][0]
    environment = {item["name"]: item["value"] for item in container["env"]}
    assert environment["JOB_COMPLETIONS"] == str(spec["completions"])
    assert spec["podFailurePolicy"]["rules"][0]["onExitCodes"]["values"] == [42]
    command = [word.replace("/shared/flights.csv", "m.csv").replace("/shared/run", "job") for word in container["command"]]
    for index in range(3):
        variables = {"JOB_COMPLETION_INDEX": str(index), "JOB_COMPLETIONS": "3"}
        run(*command, cwd=folder, env=dict(os.environ, PATH=path, **variables))
    assert run(lookout, "merge", "job", cwd=folder) == expected
    print("Slurm's script and the Kubernetes job, three tasks each: the same report")


def main():
    lookout = sys.argv[1]
    # Ray's sockets need a short path.
    with tempfile.TemporaryDirectory(prefix="lr", dir="/tmp") as name:
        folder = pathlib.Path(name)
        for number in range(CLIPS):
            run(lookout, "simulate", "--out", f"data/{number:02}", "--kind", KINDS[number % 4], "--seed", str(number),
                "--width", "96", "--height", "72", "--fps", "10", "--seconds", "1.2", cwd=folder)
        run(lookout, "manifest", "data", "--out", "m.csv", cwd=folder)
        started = time.monotonic()
        expected = run(lookout, "eval", "data", "--jobs", "1", cwd=folder)
        print(f"one machine, one job: {CLIPS / (time.monotonic() - started) * 3600:.0f} clips an hour")
        engines(lookout, folder, expected)
        ray_loses_a_worker(lookout, folder, expected)


main()
