// What stands between policy and arm, and where people stop: graphs of hrl_comfort.studio.web.safety, as sim.episodes uses them.

import { compile } from "./graph.js";

const row = (values) => ({ shape: [1, values.length], data: values });
const limbRow = (poses) => ({ shape: [1, poses.length, 7], data: poses.flat() });

export class Safety {
  constructor(given, step) {
    this.given = given;
    this.step = step;
    for (const name of ["drive", "gap", "walked", "pairs", "bodies"]) this[`${name}Graph`] = given[name] && compile(given[name]);
  }

  /** Whether set-points are rated, and perhaps shielded. */
  get drives() {
    return this.driveGraph !== null;
  }

  /** Begin an episode at some velocity of the set-points, rad/s, beside a person. */
  begin(velocity, limbs) {
    Object.assign(this, { velocity, trail: this.given.trail, share: 1, braking: false, stops: 0, reach: 0, touched: new Set() });
    // They may come at the largest speed.
    this.before = limbs.map(([x, y, z, ...turn]) => [x, y, z + this.given.first_step, ...turn]);
    this.see(limbs);
  }

  /** Keep the limbs of a person as a decision of `steps` control steps begins. */
  see(limbs, steps = 1) {
    this.seen = { limbs, since: steps * this.step };
  }

  /** Return the fields about the capsules of an arm at some angles (rad) and of a person, since the decision before. */
  bodies(angles, limbs) {
    const { seen } = this, bodies = this.bodiesGraph({
      joint_pos: row(angles), limbs: limbRow(limbs), limbs_before: limbRow(seen.limbs), since: { shape: [1], data: [seen.since] },
    });
    return Object.fromEntries(
      Object.entries(bodies).map(([name, data]) => {
        const width = name === "humans_body_vel" ? 6 : 7;
        return [name, { shape: [1, data.length / width, width], data }];
      }),
    );
  }

  /**
   * Return the set-points (rad) at the beginning and at the end of a control step in which the policy asks for increments
   * (rad), of an arm with these joints; where it does not follow them, they begin at the arm.
   */
  drive(target, increment, joints, limbs) {
    const shape = this.given.drive.shapes.trail;
    const made = this.driveGraph({
      ...joints, joint_target: row(target), target_vel: row(this.velocity), asked: row(increment.map((angle) => angle / this.step)),
      limbs: limbRow(limbs), limbs_before: limbRow(this.before), trail: { shape, data: this.trail },
    });
    const braking = Boolean(made.braking[0]);
    this.stops += Number(braking && !this.braking);
    Object.assign(this, { velocity: made.target_vel, trail: made.trail ?? this.trail, share: made.share[0], braking, reach: made.reach?.[0] ?? 0, before: limbs });
    return [made.begin, made.joint_target];
  }

  /** Return the share of a person's step, from limbs to limbs, that ends where they touch the arm; 1 if it is free. */
  walked(angles, before, limbs) {
    if (!this.given.stops) return 1;
    const fields = { joint_pos: row(angles), limbs: limbRow(limbs) };
    if (this.gapGraph(fields).gap[0] > 0) return 1;
    return this.walkedGraph({ ...fields, limbs_before: limbRow(before) }).share[0];
  }

  /** Return whether a part of an arm with these readings that begins to touch one of the person's hits it. */
  unsafe({ joint_pos, joint_vel }, limbs) {
    const { apart, speed } = this.pairsGraph({ joint_pos: row(joint_pos), joint_vel: row(joint_vel), limbs: limbRow(limbs) });
    const touched = new Set([...apart.keys()].filter((pair) => apart[pair] <= this.given.touch));
    const unsafe = [...touched].some((pair) => !this.touched.has(pair) && speed[pair] > this.given.unsafe_speed);
    this.touched = touched;
    return unsafe;
  }

  /** No part of the arm touches the person. */
  clear() {
    this.touched = new Set();
  }
}
