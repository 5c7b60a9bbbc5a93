#!/usr/bin/env bash
# Train and measure every reference result anew: docs/reference.sh [FOLDER] (default runs/remade).
# Each command can be pasted alone; one that was stopped goes on when it is given again (`train`: as `train resume=FOLDER`).
set -euo pipefail
export OMP_NUM_THREADS=1
out=${1:-runs/remade}
all='episodes=1000 group_by=[seen]'
levels='levels=[1,2,3,4,5,6,7,8,9,10]'

# Pick, place and return at 10 cm, and the cycle; the same by a rated arm behind the shield.
hrl-comfort train hierarchy experiment=cycle output=$out/cycle
for t in pick place return; do
    hrl-comfort evaluate policy=$out/cycle/$t split=validation episodes=1000 output=$out/cycle/$t/validation
done
hrl-comfort evaluate task=cycle meta_controller=scripted policies.pick=$out/cycle/pick policies.place=$out/cycle/place \
    policies.return=$out/cycle/return split=validation episodes=1000 output=$out/cycle/cycle/validation
for s in 0 1 2; do for d in three two; do
    hrl-comfort train hierarchy experiment=shielded division=$d train_seed=$s output=$out/shielded/$d$s
done; done
# The three subtasks from 30 cm to 2 cm.
for task in pick place return; do
    hrl-comfort train experiment=fine task=$task output=$out/fine/$task
    hrl-comfort evaluate policy=$out/fine/$task $all output=$out/fine/$task/eval
done

# One policy for ten comfort levels at 30 cm, and the skills of a shift for ten levels, with and without comfort.
for s in 0 1 2 3 4; do
    hrl-comfort train experiment=comfort train_seed=$s episode_seed=$s output=$out/comfort/seed$s
    hrl-comfort evaluate policy=$out/comfort/seed$s episodes=1000 $levels output=$out/comfort/seed$s/paper
    hrl-comfort evaluate policy=$out/comfort/seed$s split=validation episode_seed=890000 episodes=1000 $levels \
        output=$out/comfort/seed$s/validation
    hrl-comfort train hierarchy experiment=comfort_shift train_seed=$s output=$out/comfort_shift/levels$s
    hrl-comfort train hierarchy experiment=comfort_shift comfort=off 'hierarchy.levels=[]' train_seed=$s output=$out/comfort_shift/off$s
    for kind in levels off; do hrl-comfort benchmark split=validation policy=$out/comfort_shift/$kind$s output=$out/benchmark/$kind-$s; done
    hrl-comfort benchmark split=validation policy=$out/comfort_shift/levels$s comfort.source=frightened 'levels=[]' output=$out/benchmark/told-$s
done
for p in expert potential_field predictive_sampling; do hrl-comfort benchmark split=validation policy=$p output=$out/benchmark/$p; done
for p in expert potential_field predictive_sampling $out/comfort_shift/levels{0,1,2,3,4}; do
    hrl-comfort benchmark split=validation safety=none 'levels=[1,10]' policy=$p output=$out/unshielded/$(basename $p)
done

# The cycle with levels; the same with a learned controller that sorts balls; the cycle with one to three networks.
for s in 0 1 2; do
    seeds="train_seed=$s episode_seed=$s"
    for experiment in comfort_cycle sort; do
        hrl-comfort train hierarchy experiment=$experiment $seeds output=$out/$experiment/seed$s
    done
    for division in one two three; do
        hrl-comfort train hierarchy experiment=cycle division=$division $seeds output=$out/divisions/$division/seed$s
    done
done

# Two baselines that learn nothing.
for t in reach point_to_point pick place return pick_place cycle; do hrl-comfort evaluate task=$t policy=expert $all output=$out/expert/$t; done
hrl-comfort evaluate task=pick_place policy=potential_field comfort=conditioned $all $levels \
    task.precision.grasp_tolerance_m=0.30 task.precision.place_tolerance_m=0.30 output=$out/comfort/potential_field

# The paper's two experiments, with its reward.
for s in 0 1 2 3 4; do
    seeds="train_seed=$s episode_seed=$s"
    hrl-comfort train experiment=paper_experiment_1 $seeds output=$out/paper/seed$s/pick_place
    hrl-comfort train experiment=paper_experiment_1 task=return agent.policy_steps=100000 $seeds output=$out/paper/seed$s/return
    for l in 1 4 7 10; do hrl-comfort train experiment=paper_experiment_2 comfort.level=$l $seeds output=$out/paper/seed$s/level_$l; done
    for each in pick_place return level_1 level_4 level_7 level_10; do hrl-comfort evaluate policy=$out/paper/seed$s/$each $all; done
done

# Figures; each writes its numbers beside it as JSON.
hrl-comfort figure kind=levels "evaluations=['$out/comfort/seed*/validation']" output=$out/comfort/levels.png
hrl-comfort figure kind=plane "evaluations=['$out/comfort/seed*/paper','$out/comfort/potential_field']" \
    'labels=[one policy,potential field]' output=$out/comfort/plane.png
hrl-comfort figure kind=levels "evaluations=['$out/comfort_cycle/seed*/cycle/eval']" output=$out/comfort_cycle/levels.png
hrl-comfort figure kind=controllers 'labels=[learned,scripted]' output=$out/sort/controllers.png \
    "evaluations=['$out/sort/seed*/sort_learned/eval','$out/sort/seed*/sort_scripted/eval']"
hrl-comfort figure kind=levels "evaluations=['$out/paper/seed*/level_*/eval']" output=$out/paper/levels.png
hrl-comfort figure kind=divisions 'labels=[one,two,three]' output=$out/divisions/divisions.png \
    "evaluations=['$out/divisions/one/*/cycle/eval','$out/divisions/two/*/cycle/eval','$out/divisions/three/*/cycle/eval']"

# Benchmarks, on an idle machine.
hrl-comfort bench env output=$out/bench
hrl-comfort bench safety task=pick_place human=mixture task.terminate_on=unsafe_contact output=$out/bench
hrl-comfort bench update output=$out/bench
hrl-comfort bench train task=pick output=$out/bench
