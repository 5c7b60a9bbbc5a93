// The cell: MuJoCo's physics, the person, the task's stages and the options' policies, stepped as hrl_comfort.sim.engine does.

import { compile } from "./graph.js";
import { Hand } from "./hand.js";
import { Person, limbPoses } from "./person.js";
import { Safety } from "./safety.js";

const row = (values) => ({ shape: [1, values.length], data: values });
const one = (value) => ({ shape: [1], data: [value] });

/** Return the float32 numbers of {shape: [rows, columns], float32} as rows. */
export function table({ shape: [rows, columns], float32 }) {
  const bytes = Uint8Array.from(atob(float32), (letter) => letter.charCodeAt(0));
  const values = new Float32Array(bytes.buffer);
  return Array.from({ length: rows }, (_, k) => Array.from(values.subarray(k * columns, (k + 1) * columns)));
}

export class Cell {
  /** `content` is what hrl_comfort.studio.web.content made; `mujoco` the WebAssembly module. */
  constructor(mujoco, content) {
    this.mujoco = mujoco;
    this.content = content;
    const files = Object.entries(content.assets);
    const vfs = new mujoco.MjVFS();
    for (const [name, base64] of files) vfs.addBuffer(name, Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0)));
    this.model = mujoco.MjModel.from_xml_string(content.xml, vfs);
    this.data = new mujoco.MjData(this.model);
    this.nextStage = compile(content.stages.graph);
    this.options = content.options.map((option) => ({ ...option, act: compile(option.graph) }));
    this.safety = new Safety(content.safety, content.person.step_s);
    this.hand = content.hand && new Hand(content.hand, content.person.step_s, (key) => this.sensed(key));
    this.person = new Person(content.person);
    this.level = content.level;
    this.episode = -1;
    this.counts = { success: 0, contact: 0, other: 0 };
    /** Touches of the person, and those by an arm that moved fast towards them. */
    this.touches = { all: 0, unsafe: 0 };
    this.watchers = [];
    this.reset();
  }

  /** Begin the next episode. */
  reset(episode = (this.episode + 1) % this.content.episodes.length) {
    const { data, content } = this, given = content.episodes[episode];
    this.episode = episode;
    this.mujoco.mj_resetData(this.model, data);
    data.qpos.set(given.qpos);
    data.qvel.set(given.qvel);
    this.target = given.joint_target;
    this.person.begin(table(given.walk));
    this.pose();
    this.safety.begin(given.target_vel, this.limbs);
    this.state = { stage: 0, steps: 0, touching: false, contact: false, unsafe: false, level: this.level };
    this.object = { place: given.object, kind: given.kind };
    this.outcome = null;
    this.option = null;
    this.decision = null;
    this.hand?.begin(given);
    this.look();
    this.hand?.read();
    this.choose();
  }

  /** Pose the person's limbs. */
  pose() {
    this.limbs = limbPoses(this.person.walk, this.content.body, this.content.floor);
  }

  /** Read the cell as it stands, held by its set-points. */
  look() {
    this.control(this.target, this.hand?.control);
    this.mujoco.mj_forward(this.model, this.data);
    this.read();
    this.touch(this.feels);
  }

  /** Write targets of the servos and of the hand's drive, person, and the cell's places and obstacles. */
  control(targets, grip) {
    const { mocap_pos: places, mocap_quat: turns } = this.data;
    this.data.ctrl.set(grip === undefined ? targets : [...targets, grip]);
    [...this.limbs, ...this.content.layout].forEach((pose, limb) => {
      places.set(pose.slice(0, 3), 3 * limb);
      turns.set(pose.slice(3), 4 * limb);
    });
  }

  /** Return the sensors' numbers of a key. */
  sensed(key) {
    const [from, to] = this.content.sensors[key];
    return Array.from(this.data.sensordata.subarray(from, to));
  }

  /** Whether the arm touches the person in this physics step. */
  get feels() {
    return this.sensed("human").some(Boolean);
  }

  read() {
    const { state } = this;
    state.joint_pos = this.sensed("joint_pos");
    state.joint_vel = this.sensed("joint_vel");
    state.tcp_pos = this.sensed("tcp_pos");
    state.hit = this.sensed("table").some(Boolean) ? "the cell" : this.sensed("self").some(Boolean) ? "itself" : null;
  }

  /** Tell whether the arm touches the person, now or in the control step. */
  touch(touching) {
    this.state.touching = touching;
    this.state.contact ||= touching;
  }

  /** Return the fields of the state that graphs read, as of one row. */
  fields(stage, level) {
    const { state, content, object, person } = this, { place, yaw } = person.walk;
    const people = (data) => ({ shape: [1, 1, data.length], data });
    return {
      joint_pos: row(state.joint_pos), joint_vel: row(state.joint_vel), joint_target: row(this.target),
      tcp_pos: row(state.tcp_pos), tcp_home: row(content.tcp_home), joint_home: row(content.home),
      humans_pos: people(place), humans_yaw: row([yaw]), humans_seen: people(place),
      target_object: row(object.place), target_place: row(content.kind_places[object.kind]), target_kind: one(object.kind),
      kind_places: { shape: [1, content.kind_places.length, 3], data: content.kind_places.flat() },
      tops: { shape: [1, content.tops.length, 6], data: content.tops.flat() },
      points: { shape: [1, 2, 3], data: content.episodes[this.episode].points.flat() },
      stage: one(stage), level: one(level), steps: one(state.steps),
      grasp_tolerance: one(content.tolerances.grasp), place_tolerance: one(content.tolerances.place),
      home_tolerance: one(content.tolerances.home), share: one(this.safety.share), ...this.hand?.fields,
    };
  }

  /** Return the stage in force after this instant. */
  stageAfter() {
    return this.nextStage(this.fields(this.state.stage, this.state.level)).made[0];
  }

  /** Start the option whose stages hold the one in force. */
  choose() {
    const { state } = this;
    const chosen = this.options.findIndex(({ first, last }) => first <= state.stage && state.stage < last);
    this.attempt = chosen === this.option ? this.attempt + 1 : 1;
    this.option = Math.max(chosen, 0);
    this.started = state.steps;
  }

  limit(limits) {
    return limits[Math.round(this.state.level) - 1] ?? limits[0];
  }

  /** Return the increments (rad a control step), and the command of the fingers, that the option in force chooses now. */
  act() {
    const { state, safety } = this, { act, first } = this.options[this.option];
    const bodies = safety.bodies(state.joint_pos, this.limbs);
    return act({ ...this.fields(Math.max(state.stage - first, 0), state.level), ...bodies }).made;
  }

  /** Run one control step of 20 ms, the first one of a decision after the policy has acted; true where a decision ended. */
  step() {
    if (this.outcome) this.reset();
    const { content, state, data, model, safety } = this, substeps = content.substeps;
    if (state.steps === 0 && state.touching) return this.waitForPerson();
    if (!this.decision) {
      state.level = this.level;
      const action = Array.from(this.act()), joints = this.target.length;
      this.decision = { from: [...this.target], increment: action.slice(0, joints), command: action[joints], steps: 0, limbs: this.limbs };
    }
    const { from, increment, command, steps } = this.decision, touched = state.touching;
    const ramp = (share) => from.map((angle, joint) => {
      const [lowest, highest] = content.range[joint];
      return Math.min(Math.max(angle + (steps + share) * increment[joint], lowest), highest);
    });
    const [angles, speeds] = content.moving, measured = angles.map((at) => data.qpos[at]);
    const joints = { joint_pos: row(measured), joint_vel: row(speeds.map((at) => data.qvel[at])) };
    const [begin, after] = safety.drives ? safety.drive(this.target, increment, joints, this.limbs) : [from, ramp(1)];
    this.walk(safety.drives ? measured : after);
    const grips = this.hand?.follow(command);
    let touching = false, unsafe = false;
    for (let k = 1; k <= substeps; k++) {
      const share = k / substeps;
      const targets = safety.drives ? begin.map((angle, joint) => angle + share * (after[joint] - angle)) : ramp(share);
      this.control(targets, grips?.[k - 1]);
      this.mujoco.mj_step(model, data);
      if (this.feels) {
        // The readings are those before the physics resolves the touch.
        unsafe = safety.unsafe({ joint_pos: this.sensed("joint_pos"), joint_vel: this.sensed("joint_vel") }, this.limbs) || unsafe;
        touching = true;
      } else safety.clear();
    }
    this.target = after;
    this.read();
    this.touch(touching);
    this.touches.all += Number(touching && !touched);
    this.touches.unsafe += Number(unsafe && !state.unsafe);
    state.unsafe ||= unsafe;
    state.steps += 1;
    this.hand?.watch(state.steps);
    this.decision.steps += 1;
    const stage = state.stage;
    state.stage = this.stageAfter();
    const failed = this.failedContact || state.hit !== null || Boolean(this.hand?.lost), late = state.steps >= this.limit(content.limits.episode);
    const ended = state.stage !== stage || failed || late || this.decision.steps === content.action_repeat;
    if (ended) this.endDecision(failed, late);
    return ended;
  }

  /** Let the person walk on for a control step, at most up to an arm at some angles (rad). */
  walk(angles) {
    const { person } = this, before = person.walk, limbs = this.limbs;
    person.advance();
    this.pose();
    const share = this.safety.walked(angles, limbs, this.limbs);
    if (share === 1) return;
    person.hold(before, share);
    this.pose();
  }

  /** Whether a contact has ended the episode. */
  get failedContact() {
    return this.content.safety.terminate_on === "contact" ? this.state.contact : this.state.unsafe;
  }

  /** Let a person who stands in the way of the arm at its start walk on; the episode begins once they are gone. */
  waitForPerson() {
    this.person.advance();
    this.pose();
    this.safety.before = this.limbs;
    this.safety.see(this.limbs);
    this.state.contact = false;
    this.look();
    return true;
  }

  endDecision(failed, late) {
    const { state, content } = this, success = state.stage >= content.stages.names.length;
    this.safety.see(this.decision.limbs, this.decision.steps);
    this.decision = null;
    if (failed) this.finish(this.failedContact ? "contact" : state.hit ? `hit ${state.hit}` : "object lost");
    else if (success) this.finish("success");
    else if (late) this.finish("out of time");
    else if (this.options[this.option].last <= state.stage || state.stage < this.options[this.option].first) this.choose();
    else if (state.steps - this.started >= this.limit(content.limits.option)) {
      if (content.retries !== null && this.attempt > content.retries) this.finish("out of time");
      else this.choose();
    }
  }

  finish(outcome) {
    this.outcome = outcome;
    this.counts[outcome in this.counts ? outcome : "other"] += 1;
    for (const watch of this.watchers) watch(outcome);
  }

  /** Where the object is: where it arrived, on the tool or where it belongs; null without one, or with one that is a body. */
  get objectPlace() {
    const { object, content, state } = this, where = content.stages.object[state.stage];
    if (this.hand || where === "nowhere") return null;
    return { arrival: object.place, tool: state.tcp_pos, place: content.kind_places[object.kind] }[where];
  }

  /** Horizontal distance from the tool to the person's axis, m. */
  get distance() {
    const { tcp_pos: tool } = this.state, [x, y] = this.person.walk.place;
    return Math.hypot(tool[0] - x, tool[1] - y);
  }

  /** Name of the stage in force. */
  get stage() {
    return this.content.stages.names[Math.min(this.state.stage, this.content.stages.names.length - 1)];
  }
}
