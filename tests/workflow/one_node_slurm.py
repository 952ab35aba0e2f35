"""A SLURM of one node on the loopback interface, as long as a test needs it. Debian: slurm-wlm, munge; as root."""

from __future__ import annotations

import ctypes
import os
import secrets
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

PR_SET_PDEATHSIG = 1
DAEMONS = ("munged", "slurmctld", "slurmd")
CONF = """\
ClusterName=one
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
CommunicationParameters=NoCtldInAddrAny,NoInAddrAny
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SchedulerParameters=sched_interval=2,bf_interval=2
ReturnToService=2
MinJobAge=900
NodeName=localhost NodeAddr=127.0.0.1 NodeHostname={host} CPUs=2 RealMemory=12000 State=UNKNOWN
PartitionName=debug Nodes=localhost Default=YES MaxTime=INFINITE State=UP
"""


def installed() -> bool:
    """Whether the daemons are there and may be started."""
    return os.geteuid() == 0 and all(shutil.which(name, path=_path()) for name in DAEMONS)


def _path() -> str:
    return os.pathsep.join([*os.get_exec_path(), "/usr/sbin", "/usr/local/sbin"])


def _free_port() -> int:
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def one_node(folder: Path) -> Iterator[dict[str, str]]:
    """Environment variables by which SLURM's commands find this node; whatever was started is ended afterwards."""
    folder.mkdir(mode=0o755, parents=True)
    for name in ("state", "spool"):
        (folder / name).mkdir()
    key = folder / "munge.key"
    key.write_bytes(secrets.token_bytes(1024))
    key.chmod(0o400)
    conf = folder / "slurm.conf"
    conf.write_text(
        CONF.format(folder=folder, host=socket.gethostname().split(".")[0], ports=(_free_port(), _free_port()))
    )
    env = os.environ | {"SLURM_CONF": str(conf), "PATH": _path()}
    places = {"socket": "socket", "key-file": "key", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}
    munge = [f"--{option}={folder}/munge.{end}" for option, end in places.items()]
    with ExitStack() as running:
        for command in (
            ["munged", "--foreground", "--force", *munge],
            ["slurmctld", "-D", "-i"],
            ["slurmd", "-D", "-N", "localhost"],
        ):
            running.enter_context(_daemon(command, env, folder))
        _wait_for_the_node(env, folder)
        yield {"SLURM_CONF": str(conf), "PATH": f"{_commands(folder, conf)}{os.pathsep}{os.environ['PATH']}"}
        subprocess.run(["scancel", "--user", "root"], env=env, check=False, capture_output=True, timeout=60)


def _commands(folder: Path, conf: Path) -> Path:
    """A folder with SLURM's commands that know this configuration, also within jobs, which are given no SLURM_CONF."""
    made = folder / "bin"
    made.mkdir()
    for name in ("sbatch", "srun", "squeue", "scancel", "sinfo", "scontrol"):
        (made / name).write_text(f'#!/bin/sh\nSLURM_CONF="{conf}" exec "{shutil.which(name)}" "$@"\n')
        (made / name).chmod(0o755)
    return made


@contextmanager
def _daemon(command: list[str], env: dict[str, str], folder: Path) -> Iterator[None]:
    with (folder / f"{command[0]}.out").open("wb") as out:
        process = subprocess.Popen(
            command, env=env, stdout=out, stderr=subprocess.STDOUT, start_new_session=True, preexec_fn=_end_with_parent
        )
        try:
            yield
        finally:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _end_with_parent() -> None:
    """A daemon ends when the test is killed."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _wait_for_the_node(env: dict[str, str], folder: Path, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        asked = subprocess.run(
            ["sinfo", "--noheader", "--format=%T"], env=env, capture_output=True, text=True, timeout=30, check=False
        )
        if asked.stdout.strip() == "idle":
            return
        time.sleep(0.5)
    logs = {path.name: path.read_text()[-2000:] for path in sorted(folder.glob("*.log")) + sorted(folder.glob("*.out"))}
    raise RuntimeError(f"the node is not idle after {seconds:g} s: {logs}")
