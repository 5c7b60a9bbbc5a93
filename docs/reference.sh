#!/usr/bin/env bash
# Remakes runs/reference, a part at a time: docs/reference.sh line|points|fine|approach|curriculum|comfort|comfort_quick|comfort_10cm|comfort_cycle|sort|sort_learned|speed|fixed|forms|field|figures|figures_10cm|figures_cycle|figures_sort|divisions|seams|figures_divisions|figures_seams|expert
# A policy that is there is not trained again; REFERENCE=DIR puts everything elsewhere; SEEDS='0 1' does some training
# seeds of a part that has several, and JOBS=2 two of those at a time.
set -euo pipefail
cd "$(dirname "$0")/.."
export OMP_NUM_THREADS=1
ref=${REFERENCE:-runs/reference}
hrl=(.venv/bin/hrl-comfort)

train() { # [meta] folder, overrides; a training that was stopped goes on
    local verb=(train)
    if [ "$1" = meta ]; then
        verb+=(meta)
        shift
    fi
    if grep -qs '"finished": true' "$ref/$1/provenance.json"; then return; fi
    if stopped "$ref/$1"; then
        "${hrl[@]}" "${verb[@]}" "resume=$ref/$1"
    else
        "${hrl[@]}" "${verb[@]}" "output=$ref/$1" "${@:2}"
    fi
}
stopped() { # folder: a checkpoint is there to go on from
    [ -e "$1/checkpoints/latest.pt" ] || [ -e "$1/checkpoints/previous.pt" ]
}
measure() { # folder, overrides
    "${hrl[@]}" evaluate "output=$ref/$1" episodes=1000 'group_by=[seen]' "${@:2}"
}
measure_levels() { # folder, overrides; the same episodes at each of ten levels
    measure "$1" 'levels=[1,2,3,4,5,6,7,8,9,10]' "${@:2}"
}
figure() { # name, overrides
    "${hrl[@]}" figure "output=$ref/comfort/$1.png" "${@:2}"
}
record() { # folder, episodes, policy, overrides
    "${hrl[@]}" evaluate "output=$ref/comfort/$1" record=true episodes="$2" "policy=$3" "${@:4}"
}
endings() { # how a policy leaves the arm, over episodes drawn as in training: the evaluation set stays held out
    [ -f "$ref/$1/terminal_states.npz" ] || "${hrl[@]}" evaluate "policy=$ref/$1" episodes=2000 "terminal_states=$ref/$1/terminal_states.npz"
}

line() { # pick, place and return, each begun where the one before it ends, and their chain
    train pick experiment=reference task=pick agent.policy_steps=120000
    endings pick
    train place experiment=reference task=place agent.policy_steps=300000 "task.start=$ref/pick/terminal_states.npz"
    endings place
    train return experiment=reference task=return agent.policy_steps=200000 "task.start=$ref/place/terminal_states.npz"
    for task in pick place return; do measure $task/eval "policy=$ref/$task"; done
    measure cycle/eval task=cycle meta_controller=scripted \
        "policies.pick=$ref/pick" "policies.place=$ref/place" "policies.return=$ref/return"
}

points() { # reaching points to 5 cm; the longer way is trained on, past 5 cm, lest it stop short
    train reach experiment=points task=reach
    train point_to_point_first experiment=points task=point_to_point agent.policy_steps=600000
    train point_to_point_second experiment=points task=point_to_point agent.policy_steps=300000 \
        "initial_policy=$ref/point_to_point_first" curriculum.start_m=0.05 curriculum.end_m=0.03 reward.arrival_speed=0
    train point_to_point experiment=points task=point_to_point agent.policy_steps=200000 agent.learning_rate=1e-4 \
        "initial_policy=$ref/point_to_point_second" curriculum.start_m=0.03 curriculum.end_m=0.03 reward.arrival_speed=0
    for task in reach point_to_point_first point_to_point_second point_to_point; do measure $task/eval "policy=$ref/$task"; done
}

fine() { # the line's policies trained on to 2 cm
    for task in pick place return; do
        start=$(sed -n 's/^  start: //p' "$ref/$task/config.yaml")
        train fine/$task experiment=fine task=$task "initial_policy=$ref/$task" "task.start=$start"
        for cm in 10 5 2; do
            measure fine/$task/eval_${cm}cm "policy=$ref/fine/$task" \
                "task.precision.grasp_tolerance_m=0.$(printf %02d $cm)" "task.precision.place_tolerance_m=0.$(printf %02d $cm)" \
                "task.precision.home_tolerance_deg=$cm"
        done
    done
}

approach() { # beside somebody who walks at the gripper, a touch ever dearer, at last from all round; and blind to it
    train pick_place_approach_first experiment=approach
    train pick_place_approach_second experiment=approach agent.policy_steps=200000 curriculum=off \
        reward.human_collision=-40 "initial_policy=$ref/pick_place_approach_first"
    train pick_place_approach experiment=approach agent.policy_steps=400000 curriculum=off reward.human_collision=-100 \
        human.spawn=anywhere 'human.spawn_radius_m=[0.38,1.3]' "initial_policy=$ref/pick_place_approach_second"
    for part in pick_place_approach_first pick_place_approach_second pick_place_approach; do
        measure $part/eval "policy=$ref/$part"
        measure $part/masked "policy=$ref/$part" human.masked=true
    done
    measure expert/pick_place_approach task=pick_place policy=expert human=approach
}

curriculum() { # adaptive against off, the same number of decisions, three seeds
    for kind in adaptive off; do curriculum_of $kind; done
}

curriculum_of() {
    for seed in 0 1 2; do
        folder=curriculum/$1_$seed
        train $folder task=pick_place "curriculum=$1" agent.policy_steps=40000 train_seed=$seed episode_seed=$seed
        measure $folder/eval "policy=$ref/$folder"
    done
}

comfort() { # one policy for ten levels, by training seed: the task, the levels in earnest, shown ways round, farther apart
    last=()
    for seed in ${SEEDS:-0 1 2 3 4}; do levels_of comfort/seed$seed; done
}

comfort_quick() { # the same with two fifths of the updates, three fifths in the last part, and the mean of its actors
    last=(agent.updates_per_policy_step=0.15 agent.ema_rate=5e-4)
    for seed in ${SEEDS:-0 1 2 3 4}; do levels_of comfort/quick/seed$seed agent.updates_per_policy_step=0.1; done
}

levels_of() { # folder, overrides; those in `last` are of the last part alone
    to=$1 more=("train_seed=$seed" "episode_seed=$seed" "${@:2}")
    train $to/pick_place_first experiment=comfort_gentle "${more[@]}"
    train $to/pick_place_second experiment=comfort_conditioned "${more[@]}" \
        "initial_policy=$ref/$to/pick_place_first"
    train $to/pick_place_third experiment=comfort_nearer "${more[@]}" "initial_policy=$ref/$to/pick_place_second"
    train $to/pick_place experiment=comfort_nearest "${more[@]}" "${last[@]}" "initial_policy=$ref/$to/pick_place_third"
    measure_levels $to/eval "policy=$ref/$to/pick_place"
}

comfort_10cm() { # on to 10 cm: shown how, alone, in smaller steps, and without delay
    for seed in ${SEEDS:-0 1 2}; do
        to=comfort/seed$seed seeds=("train_seed=$seed" "episode_seed=$seed")
        train $to/pick_place_10cm_first experiment=comfort_10cm "${seeds[@]}" "initial_policy=$ref/$to/pick_place"
        train $to/pick_place_10cm_second experiment=comfort_10cm_alone "${seeds[@]}" \
            "initial_policy=$ref/$to/pick_place_10cm_first"
        train $to/pick_place_10cm_third experiment=comfort_10cm_finer "${seeds[@]}" \
            "initial_policy=$ref/$to/pick_place_10cm_second"
        train $to/pick_place_10cm experiment=comfort_10cm_prompt "${seeds[@]}" \
            "initial_policy=$ref/$to/pick_place_10cm_third"
        measure_levels $to/eval_10cm "policy=$ref/$to/pick_place_10cm"
    done
}

comfort_cycle() { # pick, place and return with levels, and their chain: each skill from where the one before it ends
    for seed in ${SEEDS:-0 1 2}; do
        to=comfort/seed$seed start=ik seeds=("train_seed=$seed" "episode_seed=$seed")
        for task in pick place return; do
            train $to/${task}_first experiment=comfort_skill_first task=$task "${seeds[@]}" "task.start=$start"
            train $to/${task}_second experiment=comfort_skill task=$task "${seeds[@]}" "task.start=$start" \
                "initial_policy=$ref/$to/${task}_first"
            endings $to/${task}_second
            start=$ref/$to/${task}_second/terminal_states.npz
        done
        refine comfort_skill_finer _second _third
        finish
        skills=("policies.pick=$ref/$to/pick" "policies.place=$ref/$to/place" "policies.return=$ref/$to/return")
        measure $to/cycle task=cycle meta_controller=scripted comfort=conditioned 'levels=[1,4,7,10]' "${skills[@]}" \
            task.ball_jitter_m=0.075
    done
}

finish() { # the last parts: back from where place ends, then place, paid for what it leaves to return
    last=(experiment=comfort_skill_last "${seeds[@]}")
    train $to/pick "${last[@]}" task=pick task.start=ik "initial_policy=$ref/$to/pick_third"
    many $to/pick
    many $to/place_third "task.start=$ref/$to/pick/terminal_states.npz"
    train $to/return "${last[@]}" task=return "task.start=$ref/$to/place_third/terminal_states.npz" \
        "initial_policy=$ref/$to/return_third"
    train $to/place "${last[@]}" task=place agent.policy_steps=160000 "task.start=$ref/$to/pick/terminal_states.npz" \
        "agent.next_skill=$ref/$to/return" "initial_policy=$ref/$to/place_third"
}
many() { # folder, overrides: its endings anew, more of them
    "${hrl[@]}" evaluate "policy=$ref/$1" episodes=6000 "terminal_states=$ref/$1/terminal_states.npz" "${@:2}"
}
refine() { # experiment, endings of the folders before and after: each skill trained on, place longest, for it fails most
    start=ik
    for task in pick place return; do
        more=()
        if [ $task = place ]; then more=(agent.policy_steps=160000); fi
        train $to/$task$3 experiment=$1 task=$task "${seeds[@]}" "task.start=$start" "${more[@]}" \
            "initial_policy=$ref/$to/$task$2"
        endings $to/$task$3
        start=$ref/$to/$task$3/terminal_states.npz
    done
}

sort() { # several balls, beside somebody who goes from table to table, above the skills of comfort_cycle; with mishaps,
    # and with ten seconds a skill instead of two
    for seed in ${SEEDS:-0 1 2}; do
        sorting $seed
        for name in scripted cautious random; do measure sort/seed$seed/$name "${meta[@]}" meta_controller=$name; done
        for kind in drop block; do
            measure sort/seed$seed/scripted_$kind "${meta[@]}" meta_controller=scripted disturbance=$kind
        done
        measure sort/seed$seed/scripted_patient "${meta[@]}" meta_controller=scripted meta_controller.time_limit_steps=500
    done
}

sort_learned() { # a controller that learns; while it does, a crash costs it ten balls, for on the last way home it costs none
    for seed in ${SEEDS:-0 1 2}; do
        sorting $seed
        train meta_controller sort/seed$seed/controller human=patrol "train_seed=$seed" "episode_seed=$seed" \
            "${skills[@]}" meta_controller_agent.options=180000 reward.human_collision=-10 reward.other_collision=-10
        meta+=(meta_controller=learned "policies.meta_controller=$ref/sort/seed$seed/controller")
        measure sort/seed$seed/learned "${meta[@]}"
        for kind in drop block; do measure sort/seed$seed/learned_$kind "${meta[@]}" disturbance=$kind; done
    done
}

sorting() { # seed; sets what its evaluations have in common
    to=comfort/seed$1
    skills=("policies.pick=$ref/$to/pick" "policies.place=$ref/$to/place" "policies.return=$ref/$to/return")
    meta_controller=(task=sort comfort=sort reward=sort human=patrol "${skills[@]}")
}

figures_sort() { # from the evaluations of sort
    of="$ref/sort/seed*"
    "${hrl[@]}" figure kind=controllers "output=$ref/sort/controllers.png" \
        'labels=[learned,scripted,cautious,random]' \
        "evaluations=['$of/learned','$of/scripted','$of/cautious','$of/random']"
    "${hrl[@]}" figure kind=chain "output=$ref/sort/chain.png" 'labels=[learned,scripted,cautious]' \
        "evaluations=['$of/learned','$of/scripted','$of/cautious']"
    for name in learned scripted cautious; do
        "${hrl[@]}" figure kind=timeline "output=$ref/sort/timeline_$name.png" "evaluations=[$ref/sort/seed0/$name]"
    done
}

speed() { # speed alone, from the policy that knows the task: shown how, then alone
    for seed in ${SEEDS:-0}; do
        to=comfort/speed/seed$seed seeds=("train_seed=$seed" "episode_seed=$seed")
        train ${to}_first experiment=comfort_speed "${seeds[@]}" \
            "initial_policy=$ref/comfort/seed$seed/pick_place_first"
        train $to experiment=comfort_speed_alone "${seeds[@]}" "initial_policy=$ref/${to}_first"
        measure_levels $to/eval "policy=$ref/$to"
    done
    figure speed kind=speed "evaluations=['$ref/comfort/speed/seed*/eval']"
}

fixed() { # a policy a level, and the plane of all rivals
    for level in ${LEVELS:-1 2 3 4 5 6 7 8 9 10}; do
        train comfort/fixed/level_$level experiment=comfort_fixed "comfort.level=$level" \
            "initial_policy=$ref/comfort/seed0/pick_place_third"
        measure comfort/fixed/level_$level/eval "policy=$ref/comfort/fixed/level_$level" "levels=[$level]"
    done
    figure rivals kind=plane 'labels=[one policy,a policy a level,field]' \
        "evaluations=['$ref/comfort/seed*/eval','$ref/comfort/fixed/*/eval','$ref/comfort/field']"
}

forms() { # what each form comes to, from the policy that knows the task, with the same decisions and other rewards
    forms=${FORMS:-paper reference linear logarithmic bounded eased}
    for form in $forms; do
        threshold=range scale=1
        case $form in reference) threshold=reference ;; bounded | eased) threshold=levels scale=3 ;; esac
        train comfort/forms/$form experiment=comfort_nearer agent.policy_steps=50000 "comfort.form=$form" \
            "comfort.threshold=$threshold" comfort.scale=$scale "initial_policy=$ref/comfort/seed0/pick_place_first"
        measure comfort/forms/$form/eval "policy=$ref/comfort/forms/$form" 'levels=[1,4,7,10]'
    done
    evaluations=$(printf "$ref/comfort/forms/%s/eval," $forms)
    figure forms kind=plane over=all "labels=[${forms// /,}]" "evaluations=[${evaluations%,}]"
}

field() { # the rival that learns nothing
    measure_levels comfort/field task=pick_place policy=potential_field comfort=conditioned \
        task.precision.grasp_tolerance_m=0.30 task.precision.place_tolerance_m=0.30
}

figures() { # from the evaluations of comfort, comfort_quick and field; what is recorded for a picture is not kept
    one=$ref/comfort/seed0/pick_place
    figure levels kind=levels "evaluations=['$ref/comfort/seed*/eval']"
    figure quick kind=levels "evaluations=['$ref/comfort/quick/seed*/eval']"
    figure field kind=levels "evaluations=[$ref/comfort/field]"
    figure plane kind=plane "evaluations=['$ref/comfort/seed*/eval','$ref/comfort/field']" 'labels=[one policy,field]'
    record recorded/levels 100 $one 'levels=[1,4,7,10]'
    figure paths kind=paths "evaluations=[$ref/comfort/recorded/levels]"
    for human in random_walk arc approach; do record recorded/$human 20 $one human=$human 'levels=[5]'; done
    figure people kind=people 'levels=[5]' \
        "evaluations=[$ref/comfort/recorded/random_walk,$ref/comfort/recorded/arc,$ref/comfort/recorded/approach]"
}

figures_10cm() { # from the evaluations of comfort_10cm
    ten=$ref/comfort/seed0/pick_place_10cm
    figure levels_10cm kind=levels "evaluations=['$ref/comfort/seed*/eval_10cm']"
    record recorded/calm 1000 $ten comfort.source=fixed comfort.level=10
    record recorded/jump 1000 $ten comfort.source=schedule 'comfort.schedule_s=[0,0.2]' 'comfort.schedule_levels=[10,1]'
    figure jump kind=jump jump_s=0.2 "evaluations=[$ref/comfort/recorded/calm,$ref/comfort/recorded/jump]"
}

figures_cycle() { # from the evaluations of comfort_cycle
    figure levels_cycle kind=levels "evaluations=['$ref/comfort/seed*/cycle']"
}

divisions() { # the cycle with three, two and one network, 200,000 decisions each way; a skill first alone, then from
    # where the one before it ends, and what that is worth (evaluate handover)
    for seed in ${SEEDS:-0 1 2}; do
        to=hierarchy/seed$seed
        learn three/pick task=pick agent.policy_steps=30000
        learn three/place_alone task=place agent.policy_steps=60000
        learn three/return_alone task=return agent.policy_steps=40000
        chain three/pick three/place task=place agent.policy_steps=40000
        chain three/place three/return task=return agent.policy_steps=30000
        learn two/pick_place task=pick_place agent.policy_steps=130000
        learn two/return_alone task=return agent.policy_steps=40000
        chain two/pick_place two/return task=return agent.policy_steps=30000
        learn one/cycle task=cycle agent.policy_steps=200000
        of=$ref/$to
        measure $to/three/eval task=cycle meta_controller=scripted \
            "policies.pick=$of/three/pick" "policies.place=$of/three/place" "policies.return=$of/three/return"
        measure $to/two/eval task=cycle meta_controller=scripted division=two \
            "policies.pick_place=$of/two/pick_place" "policies.return=$of/two/return"
        measure $to/one/eval task=cycle meta_controller=scripted division=one "policies.cycle=$of/one/cycle"
        handover before _alone
        handover after ""
    done
}

figures_divisions() { # from the evaluations of divisions
    of="$ref/hierarchy/seed*"
    "${hrl[@]}" figure kind=divisions "output=$ref/hierarchy/divisions.png" 'labels=[one,two,three]' \
        "evaluations=['$of/one/eval','$of/two/eval','$of/three/eval']"
    "${hrl[@]}" figure kind=handover "output=$ref/hierarchy/handover.png" 'labels=[alone,chained]' \
        "evaluations=['$of/handover_before','$of/handover_after']"
}

seams() { # handovers of the skills of comfort_cycle, at levels drawn anew for each episode
    for seed in ${SEEDS:-0 1 2}; do
        to=comfort/seed$seed
        skills=("policies.pick=$ref/$to/pick" "policies.place=$ref/$to/place" "policies.return=$ref/$to/return")
        "${hrl[@]}" evaluate handover task=cycle meta_controller=scripted comfort=conditioned episodes=1000 \
            task.ball_jitter_m=0.075 "output=$ref/hierarchy/seed$seed/handover_comfort" "${skills[@]}"
    done
}

figures_seams() { # from seams
    "${hrl[@]}" figure kind=handover "output=$ref/hierarchy/handover_comfort.png" 'labels=[skills with levels]' \
        "evaluations=['$ref/hierarchy/seed*/handover_comfort']"
}
learn() { # folder, overrides; alone, from starts made up, 30 cm to 10 cm; kept is the mean of some 2,000 updates
    train "$to/$1" experiment=reference agent.ema_rate=5e-4 "train_seed=$seed" "episode_seed=$seed" "${@:2}"
}
chain() { # the skill before, folder, overrides: trained on at 10 cm from how the skill before it leaves the arm
    endings "$to/$1"
    learn "$2" curriculum=off agent.learning_rate=1e-4 agent.critic_warmup_updates=2000 \
        "initial_policy=$ref/$to/${2}_alone" "task.start=$ref/$to/$1/terminal_states.npz" "${@:3}"
}
handover() { # name, ending of the folders of place and return
    "${hrl[@]}" evaluate handover task=cycle meta_controller=scripted episodes=1000 "output=$ref/$to/handover_$1" \
        "policies.pick=$ref/$to/three/pick" "policies.place=$ref/$to/three/place$2" \
        "policies.return=$ref/$to/three/return$2"
}

expert() { # the scripted expert: every task can be done
    for task in reach point_to_point pick place return pick_place cycle; do
        measure expert/$task task=$task policy=expert
    done
}

if [ $# = 0 ]; then set -- line; fi
if [ "${JOBS:-1}" -gt 1 ]; then
    tr ' ' '\n' <<<"${SEEDS:?JOBS goes with SEEDS}" | xargs -P "$JOBS" -I{} env JOBS=1 SEEDS={} docs/reference.sh "$@"
else
    "$@"
fi
