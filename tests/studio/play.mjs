// Evaluate graphs of a page, or play its episodes without a browser: JSON from standard input to standard output.

import { readFileSync } from "node:fs";
import loadMujoco from "../../hrl_comfort/studio/web/node_modules/@mujoco/mujoco/mujoco.js";
import { Cell } from "../../hrl_comfort/studio/web/src/cell.js";
import { Hand } from "../../hrl_comfort/studio/web/src/hand.js";
import { compile } from "../../hrl_comfort/studio/web/src/graph.js";

const given = JSON.parse(readFileSync(0));

/** Return the outputs of a graph for each of some rows {field: {shape, data}}. */
function evaluated({ graph, rows }) {
  const run = compile(graph);
  return rows.map(run);
}

/**
 * Return what happens in the first `steps` control steps of a page's episodes; the person goes to `hand`, if given, and
 * `actions` of each episode take the place of the policies'.
 */
async function played({ content, steps, hand, actions }) {
  const cell = new Cell(await loadMujoco(), content);
  return content.episodes.map((_, episode) => {
    cell.person.letGo(); // else one who stands in the arm's way has every episode wait
    cell.reset(episode);
    if (hand) cell.person.goTo(hand);
    const joints = [cell.state.joint_pos], shares = [], script = actions?.[episode];
    const objects = [cell.hand?.place], grips = [cell.hand?.grip];
    let touched = null, held = null, decisions = 0;
    if (script) cell.act = () => script[Math.min(decisions++, script.length - 1)];
    while (!cell.outcome && joints.length <= steps) {
      cell.step();
      joints.push(cell.state.joint_pos);
      shares.push(cell.safety.share);
      if (cell.state.contact) touched ??= joints.length;
      objects.push(cell.hand?.place);
      grips.push(cell.hand?.grip);
      if (cell.hand?.pads.some(Boolean)) held ??= joints.length - 1;
    }
    return { joints, shares, objects, grips, touched, held, stage: cell.state.stage, outcome: cell.outcome, unsafe: cell.state.unsafe };
  });
}

/** Return the fields of hands, and whether their object is lost, after each of the readings of some episodes. */
function watched({ hand: about, step, episodes }) {
  return episodes.map(({ begun, place, readings }) => {
    let now = null;
    const hand = new Hand(about, step, (key) => now[key]), fields = [], lost = [];
    hand.begin(begun);
    hand.place = place;
    for (const [index, reading] of readings.entries()) {
      now = reading;
      hand.watch(index + 1);
      fields.push(hand.fields);
      lost.push(hand.lost);
      if (hand.lost) break;
    }
    return { fields, lost };
  });
}

const made = given.graph ? evaluated(given) : given.episodes ? watched(given) : await played(given);
process.stdout.write(JSON.stringify(made));
