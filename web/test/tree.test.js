import assert from "node:assert/strict";
import { test } from "node:test";
import { Tree } from "../src/tree.js";

/** Numbers from 0 to 1 that are the same each time. */
function numbers(count, seed = 1) {
  let state = seed;
  return Array.from({ length: count }, () => (state = state * 48271 % 2147483647) / 2147483647);
}

test("the nearest is found as by looking at all", () => {
  for (const count of [1, 2, 13, 500]) {
    const positions = Float32Array.from(numbers(3 * count));
    const tree = new Tree(positions), asked = numbers(300, 7);
    for (let i = 0; i < asked.length; i += 3) {
      const squares = Array.from({ length: count }, (_, p) =>
        [0, 1, 2].reduce((sum, axis) => sum + (positions[3 * p + axis] - asked[i + axis]) ** 2, 0));
      const found = tree.nearest(asked[i], asked[i + 1], asked[i + 2]);
      assert.ok(Math.abs(found - Math.min(...squares)) < 1e-9, `${count}: ${found}`);
    }
  }
});

test("points that coincide, and a point itself, are told apart by their numbers", () => {
  const positions = new Float32Array(3 * 40);
  positions.set([5, 0, 0], 60);
  const tree = new Tree(positions);
  assert.equal(tree.nearest(5, 0, 0), 0);
  assert.equal(tree.nearest(5, 0, 0, 20), 25);
  assert.equal(tree.nearest(0, 0, 0, 3), 0);
});
