// How far points lie from another cloud, beside the page's own thread.

import { Tree } from "./tree.js";

onmessage = ({ data: { from, to } }) => {
  const tree = new Tree(from);
  const distances = to.map(positions => {
    const column = new Float32Array(positions.length / 3);
    for (let i = 0; i < column.length; i++) {
      column[i] = Math.sqrt(tree.nearest(positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]));
    }
    return column;
  });
  postMessage(distances, { transfer: distances.map(column => column.buffer) });
};
