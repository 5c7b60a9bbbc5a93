// The person: limbs posed as by hrl_comfort.scene.human.limb_poses, walks recorded or by hand.

const { sin, cos, hypot, PI, min, max, sqrt, atan2 } = Math;
export const STANDING = Array(18).fill(NaN);

const turned = (yaw, [x, y, z]) => [cos(yaw) * x - sin(yaw) * y, sin(yaw) * x + cos(yaw) * y, z];

/** Return the pose [x, y, z, w, i, j, k] of each limb; `walk` has place, yaw, phase, swing and limbs (18, NaN: of the gait). */
export function limbPoses({ place, yaw, phase, swing, limbs }, body, floor) {
  const angle = Number.isNaN(limbs[0]) ? swing * sin(phase) : 0;
  const sink = (body.hip - body.leg_radius) * (1 - cos(angle));
  const sides = [0, body.hip_half, -body.hip_half, body.shoulder_half, -body.shoulder_half, body.shoulder_half, -body.shoulder_half];
  const swings = [0, 1, -1, -1, 1, -1, 1];
  const half = [cos(yaw / 2), sin(yaw / 2)];
  const poses = sides.map((side, limb) => {
    const top = limb < 3 ? body.hip : body.shoulder;
    const upright = swings[limb] ? cos(angle / 2) : 1, leaning = sin(angle / 2) * swings[limb];
    const turn = [half[0] * upright, -half[1] * leaning, half[0] * leaning, half[1] * upright];
    return [place[0] - side * sin(yaw), place[1] + side * cos(yaw), floor + top - sink, ...turn];
  });
  for (const elbow of [5, 6]) {
    const forward = -body.upper_arm * sin(angle * swings[elbow - 2]);
    poses[elbow][0] += cos(yaw) * forward;
    poses[elbow][1] += sin(yaw) * forward;
    poses[elbow][2] -= body.upper_arm * cos(angle);
  }
  for (let limb = 1; limb < 7; limb++) {
    const down = limbs.slice(3 * limb - 3, 3 * limb);
    if (Number.isNaN(down[0])) continue;
    const [x, y, z] = down, turn = [1 - z, sin(yaw) * x + cos(yaw) * y, sin(yaw) * y - cos(yaw) * x, 0], length = hypot(...turn);
    poses[limb].splice(3, 4, ...(length > 1e-6 ? turn.map((value) => value / length) : [0, 1, 0, 0]));
    if (limb === 3 || limb === 4)
      turned(yaw, down).forEach((value, axis) => (poses[limb + 2][axis] = poses[limb][axis] + body.upper_arm * value));
  }
  return poses;
}

/** Return limbs (18) with the hands at two places, left first, m, in the person's frame; null is a hand that hangs. */
export function reaching(hands, body) {
  const limbs = [...STANDING], upper = body.upper_arm, fore = body.forearm;
  hands.forEach((hand, k) => {
    if (!hand) return;
    const side = k ? -1 : 1;
    const offset = [hand[0], hand[1] - side * body.shoulder_half, hand[2] - body.shoulder];
    const far = max(hypot(...offset), 1e-9), along = offset.map((value) => value / far);
    const distance = min(max(far, Math.abs(upper - fore) + 0.05), body.stretch * (upper + fore));
    const forth = (distance ** 2 + upper ** 2 - fore ** 2) / (2 * distance), aside = sqrt(upper ** 2 - forth ** 2);
    const pole = [-0.3, 0.5 * side, -0.8], lean = pole.reduce((sum, value, axis) => sum + value * along[axis], 0);
    const out = pole.map((value, axis) => value - lean * along[axis]), wide = max(hypot(...out), 1e-9);
    for (let axis = 0; axis < 3; axis++) {
      const elbow = forth * along[axis] + (aside * out[axis]) / wide;
      limbs[6 + 3 * k + axis] = elbow / upper;
      limbs[12 + 3 * k + axis] = (distance * along[axis] - elbow) / fore;
    }
  });
  return limbs;
}

/** The person of a cell: on the walk recorded for the episode, or by hand towards `target` {place, yaw (may be null), limbs}. */
export class Person {
  constructor(settings) {
    this.settings = settings;
    this.byHand = false;
    this.speedLimit = settings.speed;
  }

  /** Begin an episode with its recorded walk: rows of x, y, yaw, phase, swing and perhaps limbs, one a control step. */
  begin(rows) {
    this.rows = rows;
    this.step = 0;
    this.held = false;
    if (!this.byHand) this.walk = this.recorded(0);
  }

  recorded(step) {
    const [x, y, yaw, phase, swing, ...limbs] = this.rows[min(step, this.rows.length - 1)];
    const still = step >= this.rows.length;
    return { place: [x, y], yaw, phase, swing: still ? 0 : swing, limbs: limbs.length ? limbs : STANDING };
  }

  get there() {
    return this.walk.place[0] < this.settings.far / 2;
  }

  /** Take the person over where they are. */
  take() {
    if (this.byHand) return;
    this.byHand = true;
    this.speed = this.walk.swing / this.settings.full_swing;
    if (!this.there) this.walk = { ...this.walk, place: [...this.settings.entrance], yaw: atan2(-this.settings.entrance[1], -this.settings.entrance[0]) };
    this.stop();
  }

  /** Let the person go on as recorded, from the next episode on. */
  letGo() {
    this.byHand = false;
  }

  stop() {
    this.target = { place: [...this.walk.place], yaw: this.walk.yaw, limbs: this.walk.limbs };
  }

  /** Go to a place (m), at most `farthest` from the base, in a bearing (rad; null: faces the way). */
  goTo(place, yaw = null, limbs = STANDING) {
    this.take();
    const shrink = min(1, this.settings.farthest / max(hypot(...place), 1e-9));
    this.target = { place: place.map((value) => shrink * value), yaw, limbs };
  }

  /** Return a recorded walk from which one who was held up is still away, at most a step at the speed limit nearer. */
  catchUp(next) {
    const { place } = this.walk, offset = next.place.map((value, axis) => value - place[axis]), distance = hypot(...offset);
    const share = min(1, (this.speedLimit * this.settings.step_s) / max(distance, 1e-9));
    this.held = share < 1;
    return { ...next, place: place.map((value, axis) => value + share * offset[axis]) };
  }

  /** Stop after a share of the step that was made from the walk `before`. */
  hold(before, share) {
    this.held = true;
    this.walk = { ...before, place: before.place.map((value, axis) => value + share * (this.walk.place[axis] - value)) };
  }

  /** Walk for one control step. */
  advance() {
    this.step += 1;
    if (!this.byHand) {
      const next = this.recorded(this.step);
      this.walk = this.held ? this.catchUp(next) : next;
      return;
    }
    const { step_s: duration, full_swing: swing, stride } = this.settings, { place, yaw, phase, limbs } = this.walk;
    const offset = this.target.place.map((value, axis) => value - place[axis]), distance = hypot(...offset);
    const walked = min(this.speedLimit * duration, distance);
    const moved = place.map((value, axis) => value + (offset[axis] / max(distance, 1e-9)) * walked);
    this.speed += this.settings.smoothing * (walked / duration - this.speed);
    this.walk = {
      place: moved,
      yaw: this.target.yaw ?? (distance > this.settings.arrived ? atan2(offset[1], offset[0]) : yaw),
      phase: phase + (2 * PI * walked) / stride,
      swing: swing * min(this.speed, 1),
      limbs: this.target.limbs ?? limbs,
    };
  }
}
