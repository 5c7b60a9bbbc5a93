// The hand: the command of its fingers, and the object that it holds or lost, watched as hrl_comfort.sim.hand.sensors does.

import { compile } from "./graph.js";

const one = (value) => ({ shape: [1], data: [value] });
const ofObject = (data) => ({ shape: [1, 1, data.length], data });

export class Hand {
  /** `given` is what hrl_comfort.studio.web.hand made, `step` the time of a control step, s; `sensed` returns the readings of a key. */
  constructor(given, step, sensed) {
    Object.assign(this, { given, step, sensed });
    this.fingers = compile(given.fingers);
  }

  /** Begin an episode with an object of a kind. */
  begin({ kind, grip_target, ground, carried }) {
    Object.assign(this, { kind, target: grip_target, ground, carried, aloft: 0, free: 0, lost: false });
  }

  /** Control of the drive that holds its set-point. */
  get control() {
    return this.given.open + (this.given.closed - this.given.open) * this.target;
  }

  /** Return the controls of the drive in the physics steps of a control step with a command in [-1, 1]. */
  follow(command) {
    const { grip_target, control } = this.fingers({ grip_target: one(this.target), command: one(command) });
    this.target = grip_target[0];
    return control;
  }

  read() {
    const { kind, sensed, given: { open, closed } } = this;
    const own = (key, width) => sensed(key).slice(width * kind, width * (kind + 1));
    this.grip = (sensed("hand_pos")[0] - open) / (closed - open);
    this.speed = sensed("hand_vel")[0] / (closed - open);
    this.turn = sensed("tcp_quat");
    Object.assign(this, { place: own("object_pos", 3), facing: own("object_quat", 4), velocity: own("object_vel", 3) });
    this.pads = own("pads", 2).map((found) => Number(found > 0));
  }

  /** Take the readings after control step `steps` of the episode. */
  watch(steps) {
    const { given, step, kind, sensed } = this, before = this.place, at = sensed("object_pos").slice(3 * kind, 3 * kind + 3);
    const way = Math.hypot(...at.map((value, axis) => value - before[axis]));
    if (sensed("time")[0] < (steps - 1.5) * step || !(way < given.fastest * step)) {
      this.lost = true; // the physics diverged; MuJoCo begins again at time 0
      return;
    }
    this.read();
    const [x, y, z] = this.place, touched = this.pads.some(Boolean), held = this.pads.every(Boolean);
    if (!touched) this.ground = z;
    this.free = touched ? 0 : this.free + 1;
    this.carried = (this.carried && this.free < given.free) || (held && z - this.ground > given.carried);
    this.aloft = held && z - this.ground >= given.lift ? this.aloft + 1 : 0;
    this.lost = z < given.fallen[kind] || (Math.hypot(x, y) > given.farthest && !this.carried);
  }

  /** Fields of the state that graphs read, as of one row. */
  get fields() {
    const { sizes } = this.given;
    return {
      grip: one(this.grip), grip_vel: one(this.speed), grip_target: one(this.target), tcp_quat: { shape: [1, 4], data: this.turn },
      target: one(0), target_object: { shape: [1, 3], data: this.place }, objects_quat: ofObject(this.facing), objects_vel: ofObject(this.velocity),
      pads: ofObject(this.pads), ground: { shape: [1, 1], data: [this.ground] }, aloft_steps: { shape: [1, 1], data: [this.aloft] },
      free_steps: { shape: [1, 1], data: [this.free] }, kind_sizes: { shape: [1, sizes.length, 3], data: sizes.flat() },
    };
  }
}
