import assert from "node:assert/strict";
import { test } from "node:test";
import { Cloud, usualRange } from "../src/cloud.js";
import { duration, measure, whole } from "../src/dom.js";

/** A flat square of 100 by 100 points, one apart. */
function square(points) {
  const columns = [["nx", "nx"], ["ny", "ny"], ["nz", "nz"], ["Klasse", "classification"], ["other", null]];
  const head = { points, sent: 10_000, anchor: [0, 0, 0], colours: true, columns: columns.map(([name, role]) => ({ name, role })) };
  const cloud = new Cloud("square", /** @type {any} */ (head));
  const positions = Float32Array.from({ length: 30_000 }, (_, i) => [Math.floor(i / 300), Math.floor(i / 3) % 100, 0][i % 3]);
  const column = new Float32Array(10_000);
  cloud.add({ count: 10_000, positions, colours: null, columns: columns.map(() => column) });
  return cloud;
}

test("the spacing is told from a part, by how much more there is", () => {
  assert.equal(square(10_000).spacing(), 1);
  assert.equal(square(40_000).spacing(), 0.5);
});

test("a cloud offers what it has", () => {
  assert.deepEqual(square(10_000).colourings(), [["rgb", "Colour"], ["normal", "Normal"], ["classification", "Class"]]);
});

test("few extreme values take no colour from the others", () => {
  const values = Float32Array.from({ length: 1000 }, (_, i) => i);
  values[5] = 1e9;
  values[6] = NaN;
  const [least, greatest] = usualRange(values);
  assert.ok(least > 10 && least < 30 && greatest > 970 && greatest < 1000, `${least} ${greatest}`);
  assert.deepEqual(usualRange(new Float32Array(0)), [0, 1]);
  assert.deepEqual(usualRange(Float32Array.of(3, 3)), [3, 3]);
});

test("numbers are told as people read them", () => {
  assert.equal(whole(1234567.4), "1 234 567".replaceAll(" ", "\u202f"));
  assert.deepEqual([0, 0.00001234, 0.1234567, 12.34567, 465123.25, 1e9, NaN].map(measure),
    ["0", "1.23e-5", "0.12346", "12.346", "465123.3", "1.00e+9", "–"]);
  assert.deepEqual([0.2, 5.4, 300, 9000].map(duration),
    ["less than a second", "about 5 s", "about 5 minutes", "about 2.5 hours"]);
});
