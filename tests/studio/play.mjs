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

/** Return what happens in the first `steps` control steps of a page's episodes; the person goes to `hand`, if given. */
async function played({ content, steps, hand }) {
  const cell = new Cell(await loadMujoco(), content);
  return content.episodes.map((_, episode) => {
    cell.person.letGo(); // else one who stands in the arm's way has every episode wait
    cell.reset(episode);
    if (hand) cell.person.goTo(hand);
    const joints = [cell.state.joint_pos], shares = [];
    let touched = null;
    while (!cell.outcome && joints.length <= steps) {
      cell.step();
      joints.push(cell.state.joint_pos);
      shares.push(cell.safety.share);
      if (cell.state.contact) touched ??= joints.length;
    }
    return { joints, shares, touched, outcome: cell.outcome, unsafe: cell.state.unsafe };
  });
}

process.stdout.write(JSON.stringify(given.graph ? evaluated(given) : await played(given)));
