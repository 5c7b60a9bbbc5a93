#!/usr/bin/env bash
# Rehearse hydra/launcher=submitit_slurm on a real Slurm of one node, in a throw-away Debian container, as root.
#
#   pip install -e '.[submitit]'
#   docs/slurm_rehearsal.sh [FOLDER]    # FOLDER (default /tmp/slurm_rehearsal) gets everything and must not exist
#
# From Debian's packages it runs munged, slurmctld, slurmd, and slurmdbd on a MariaDB, for submitit asks `sacct`
# how jobs stand. No systemd, no cgroups, nothing in /etc: the daemons read FOLDER/etc and are stopped at the end.
# Then it runs three sweeps:
#   1. two jobs that work and two that cannot: the two are reported, the others finish;
#   2. of three jobs, one is told to stop (SIGTERM), as preemption does it, and one is cancelled: both leave a checkpoint, the
#      third finishes, and the command waits for it;
#   3. the same command again: it skips, resumes and resumes.
set -euo pipefail

folder=${1:-/tmp/slurm_rehearsal}
[ ! -e "$folder" ] || { echo "$folder exists; give another folder, or delete it" >&2; exit 1; }
[ "$(id -u)" = 0 ] || { echo "run as root, in a container that may be thrown away" >&2; exit 1; }
command -v hrl-comfort > /dev/null || { echo "hrl-comfort is not on the PATH; activate its environment" >&2; exit 1; }

packages="slurm-wlm slurmdbd munge mariadb-server-core mariadb-client-core"
if ! dpkg -s $packages > /dev/null 2>&1; then
  apt-get update -qq
  DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends $packages > /dev/null
fi

install -d -m 755 "$folder" "$folder"/{etc,log,state,spool,munge,db}
host=$(hostname -s)
export SLURM_CONF=$folder/etc/slurm.conf
export OMP_NUM_THREADS=1

cat > "$SLURM_CONF" << END
ClusterName=rehearsal
SlurmctldHost=$host(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket=$folder/munge/socket
CredType=cred/munge
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/state/slurmctld.pid
SlurmdPidFile=$folder/state/slurmd.pid
SlurmctldLogFile=$folder/log/slurmctld.log
SlurmdLogFile=$folder/log/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/linux
AccountingStorageType=accounting_storage/slurmdbd
AccountingStorageHost=127.0.0.1
AccountingStoragePass=$folder/munge/socket
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
KillWait=30
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(getconf _NPROCESSORS_ONLN) State=UNKNOWN
PartitionName=all Nodes=$host Default=YES MaxTime=60 State=UP
END
install -m 600 /dev/null "$folder/etc/slurmdbd.conf"
cat > "$folder/etc/slurmdbd.conf" << END
DbdHost=localhost
DbdAddr=127.0.0.1
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket=$folder/munge/socket
StorageType=accounting_storage/mysql
StorageHost=127.0.0.1
StoragePort=3399
StorageUser=slurm
StoragePass=rehearsal
LogFile=$folder/log/slurmdbd.log
PidFile=$folder/state/slurmdbd.pid
END

daemons=()
stop() {
  scancel --user=root 2> /dev/null || true
  for ((i = ${#daemons[@]} - 1; i >= 0; i--)); do kill "${daemons[i]}" 2> /dev/null || true; done
  wait
}
trap stop EXIT

start() { # NAME COMMAND...: run a daemon in the foreground of a job of this shell
  "${@:2}" > "$folder/log/$1.out" 2>&1 &
  daemons+=($!)
}

until_works() { # SECONDS COMMAND...: repeat it until it succeeds
  local end=$((SECONDS + $1))
  until "${@:2}" > /dev/null 2>&1; do
    [ $SECONDS -lt $end ] || { echo "no success in $1 s: ${*:2}; see $folder/log" >&2; exit 1; }
    sleep 1
  done
}

dd if=/dev/urandom of="$folder/munge/key" bs=1 count=1024 status=none
chmod 600 "$folder/munge/key"
start munged munged --foreground --key-file="$folder/munge/key" --socket="$folder/munge/socket" \
  --pid-file="$folder/munge/pid" --seed-file="$folder/munge/seed"
until_works 20 munge -n --socket="$folder/munge/socket"

mariadb-install-db --no-defaults --user=root --datadir="$folder/db" --auth-root-authentication-method=normal \
  > "$folder/log/mariadb-install.out" 2>&1
start mariadbd mariadbd --no-defaults --user=root --datadir="$folder/db" --socket="$folder/db/socket" \
  --pid-file="$folder/db/pid" --bind-address=127.0.0.1 --port=3399
sql() { mariadb --no-defaults --user=root --socket="$folder/db/socket" --execute="$1"; }
until_works 60 sql "select 1"
sql "create database slurm_acct_db; create user slurm@localhost identified by 'rehearsal';
     grant all on slurm_acct_db.* to slurm@localhost"

start slurmdbd slurmdbd -D
until_works 60 sacctmgr --noheader list cluster
start slurmctld slurmctld -D
until_works 60 scontrol ping
start slurmd slurmd -D -N "$host"
until_works 60 sh -c "sinfo --noheader --format=%T | grep -q idle"

show() { echo; echo "\$ $*"; "$@"; }
states() { show sacct --allocations --format=JobID%12,JobName%12,State%12,ExitCode,Elapsed,NodeList%8; }

show sinfo
small=(hydra/launcher=submitit_slurm hydra.launcher.cpus_per_task=1 hydra.launcher.timeout_min=20 task=reach
  agent.learning_starts=160 "agent.hidden=[16,16]" agent.batch_size=32 agent.log_every=160
  agent.checkpoint_every=320 engine.num_envs=8)

echo; echo "== 1. two jobs cannot work"
broken=(train -m "${small[@]}" agent.policy_steps=640 initial_policy=null,/no/such/run train_seed=0,1 output="$folder/broken")
echo "\$ hrl-comfort ${broken[*]}"
hrl-comfort "${broken[@]}" && code=0 || code=$?
echo "exit code $code"
states

echo; echo "== 2. one is told to stop, one is cancelled"
sweep=(train -m "${small[@]}" agent.policy_steps=4800 train_seed=0,1,2 output="$folder/sweep")
echo "\$ hrl-comfort ${sweep[*]}"
hrl-comfort "${sweep[@]}" > "$folder/log/sweep.out" 2>&1 &
command=$!
logged() { [ "$(wc -l < "$folder/sweep/$1/metrics.csv")" -gt 4 ]; }
array() { sacct --allocations --noheader --parsable2 --format=JobID --state=RUNNING | tail -1 | cut -d_ -f1; }
until_works 180 logged 0
show squeue
id=$(array)
show scancel --signal=TERM "${id}_0"
until_works 180 logged 1
show scancel --signal=KILL "${id}_1"  # Slurm makes a cancellation of it: SIGTERM, and SIGKILL after KillWait
wait $command && code=0 || code=$?
cat "$folder/log/sweep.out"
echo "exit code $code"
states
show cat "$folder/sweep/0/job.json"
show ls "$folder/sweep/0/checkpoints"
hrl-comfort report "$folder/sweep"
show cat "$folder/sweep/report.md"

echo; echo "== 3. the same command again"
hrl-comfort "${sweep[@]}" && code=0 || code=$?
echo "exit code $code"
states
hrl-comfort report "$folder/sweep"
show cat "$folder/sweep/report.md"
