#!/usr/bin/env bash
# Remakes runs/reference: train each subtask where the one before it ends, then evaluate all and their chain.
set -euo pipefail
cd "$(dirname "$0")/.."
export OMP_NUM_THREADS=1
hrl=(.venv/bin/python -m hrl_comfort)
ref=runs/reference

train() { "${hrl[@]}" train experiment=reference "task=$1" "output=$ref/$1" "${@:2}"; }
endings() { "${hrl[@]}" evaluate "policy=$ref/$1" episodes=1000 "endings=$ref/$1/endings.npz" "output=$ref/$1/endings"; }
measure() { "${hrl[@]}" evaluate "$@" episodes=1000 'group_by=[seen]'; }

[ -f $ref/pick/policy.pt ] || train pick agent.decisions=90000
endings pick
[ -f $ref/place/policy.pt ] || train place agent.decisions=120000 task.start=$ref/pick/endings.npz
endings place
[ -f $ref/return/policy.pt ] || train return agent.decisions=80000 task.start=$ref/place/endings.npz
for task in pick place return; do measure policy=$ref/$task; done
measure task=cycle meta=scripted policies.pick=$ref/pick policies.place=$ref/place policies.return=$ref/return \
    output=$ref/cycle/eval
