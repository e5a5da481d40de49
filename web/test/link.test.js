import assert from "node:assert/strict";
import { test } from "node:test";
import { fragmentOf, keptIn } from "../src/link.js";

const KEPT = {
  from: [465123.25, 5204987.5, -812.125], to: [1, 2, 3], up: "-y", colour: "height", compare: "slider", split: 0.25, size: 1.5,
  box: [0, 1, 2, 3, 4, 5], job: "0fc1", file: null,
};

test("a link keeps a view", () => {
  assert.deepEqual(keptIn(`#${fragmentOf(KEPT)}`), { ...KEPT, key: null });
});

test("what is missing or broken in a link is absent", () => {
  const nothing = { key: null, job: null, file: null, from: undefined, to: undefined, up: undefined, colour: undefined,
    compare: undefined, split: undefined, size: undefined, box: null };
  assert.deepEqual(keptIn(""), nothing);
  assert.deepEqual(keptIn("#from=1,2&to=x,1,2&up=w&split=a&size=&box=1,2,3,NaN,5,6"), nothing);
  assert.equal(keptIn("#key=abc").key, "abc");
});
