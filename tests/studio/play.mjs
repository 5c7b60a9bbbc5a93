// Evaluate graphs of a page, or play its episodes without a browser: JSON from standard input to standard output.

import { readFileSync } from "node:fs";
import loadMujoco from "../../hrl_comfort/studio/web/node_modules/@mujoco/mujoco/mujoco.js";
import { Cell } from "../../hrl_comfort/studio/web/src/cell.js";
import { compile } from "../../hrl_comfort/studio/web/src/graph.js";

const given = JSON.parse(readFileSync(0));

/** Return the outputs of a graph for each of some rows {field: {shape, data}}. */
function evaluated({ graph, rows }) {
  const run = compile(graph);
  return rows.map(run);
}

/** Return what happens in the episodes of a page's content; where `hand` is given, the person goes there by hand. */
async function played({ content, hand }) {
  const cell = new Cell(await loadMujoco(), content);
  return content.episodes.map((_, episode) => {
    cell.reset(episode);
    if (hand) cell.person.goTo(hand);
    const joints = [cell.state.joint_pos], shares = [];
    let touched = null;
    while (!cell.outcome) {
      cell.step();
      joints.push(cell.state.joint_pos);
      shares.push(cell.safety.share);
      if (cell.state.contact) touched ??= joints.length;
    }
    return { joints, shares, touched, stops: cell.safety.stops, outcome: cell.outcome, unsafe: cell.state.unsafe };
  });
}

process.stdout.write(JSON.stringify(given.graph ? evaluated(given) : await played(given)));
