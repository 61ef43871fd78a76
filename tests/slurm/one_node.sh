#!/usr/bin/env bash
# A SLURM cluster of this machine alone, from Debian's packages, and a study on it: the driver is
# killed and called again; in the end the same rows as in threads, and no job is left.
# As root, on a machine that may be thrown away:  apt-get install slurmctld slurmd slurm-client munge
#   tests/slurm/one_node.sh [NUMBER OF RUNS]
set -euo pipefail
runs=${1:-200}
root=$(cd "$(dirname "$0")/../.." && pwd)
work=$(mktemp -d)
host=$(hostname -s)
started=()
trap 'kill "${started[@]}" 2>/dev/null || true; echo "left behind: $work"' EXIT

# Munge vouches for who is who.
install -d -o munge -g munge -m 755 /run/munge
pgrep -x munged >/dev/null || { runuser -u munge -- munged --foreground & started+=($!); }

cat > "$work/slurm.conf" <<CONF
ClusterName=one
SlurmctldHost=$host
SlurmUser=root
AuthType=auth/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
ReturnToService=2
StateSaveLocation=$work
SlurmdSpoolDir=$work/spool
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/slurmd.pid
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc) State=UNKNOWN
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
CONF
mkdir "$work/spool"
export SLURM_CONF=$work/slurm.conf
slurmctld -D -c > "$work/slurmctld.log" 2>&1 & started+=($!)
slurmd -D > "$work/slurmd.log" 2>&1 & started+=($!)
for _ in $(seq 60); do sinfo -h -o %T 2>/dev/null | grep -q idle && break; sleep 0.5; done
sinfo

cd "$work"
"$root/.venv/bin/truestroke" study --example > study.toml
study=("$root/.venv/bin/truestroke" study study.toml --runs "$runs")
by_slurm=("${study[@]}" --executor slurm --workers "$(nproc)" --output slurm)
timeout -s KILL 20 "${by_slurm[@]}" || echo "the driver is dead; its jobs end within a minute: $(squeue -h | wc -l)"
"${by_slurm[@]}"
for _ in $(seq 90); do [ -z "$(squeue -h)" ] && break; sleep 1; done
[ -z "$(squeue -h)" ]
"${study[@]}" --output threads > /dev/null
"$root/.venv/bin/python" - "$work" <<'PYTHON'
import sqlite3, sys

def rows(name):
    return sqlite3.connect(f"{sys.argv[1]}/{name}.sqlite").execute("SELECT * FROM run ORDER BY number").fetchall()

assert rows("slurm") == rows("threads"), "not the same rows"
print(f"the same {len(rows('slurm'))} rows by SLURM and in threads")
PYTHON
