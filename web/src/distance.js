// Distances of one cloud's points to another cloud.

/** The positions of a cloud about another anchor. @returns {Float32Array[]} */
function about(cloud, anchor) {
  const shift = cloud.head.anchor.map((at, axis) => at - anchor[axis]);
  return cloud.blocks.map(block => block.positions.map((value, i) => value + shift[i % 3]));
}

function joined(parts) {
  const all = new Float32Array(parts.reduce((length, part) => length + part.length, 0));
  let at = 0;
  for (const part of parts) {
    all.set(part, at);
    at += part.length;
  }
  return all;
}

/**
 * The distance of each point to the nearest of another cloud, a column a block.
 * @returns {Promise<Float32Array[]>}
 */
export function distancesTo(other, cloud) {
  const worker = new Worker(new URL("distance-worker.js", import.meta.url), { type: "module" });
  return new Promise((resolve, reject) => {
    worker.onmessage = ({ data }) => resolve(data);
    worker.onerror = event => reject(new Error(event.message || "the distances were not computed"));
    const { anchor } = other.head;
    const from = joined(about(other, anchor)), to = about(cloud, anchor);
    worker.postMessage({ from, to }, [from.buffer, ...to.map(part => part.buffer)]);
  }).finally(() => worker.terminate());
}
