import assert from "node:assert/strict";
import { test } from "node:test";
import { unpack } from "../src/packed.js";

/** An answer of two blocks, colours and one column, in pieces of a length. */
function answer(piece, change = bytes => bytes) {
  const head = { points: 5, sent: 3, anchor: [10, 20, 30], colours: true, columns: [{ name: "i", role: "intensity" }] };
  const text = new TextEncoder().encode(JSON.stringify(head).padEnd(200));
  const block = (positions, colours, column) => [
    new Uint8Array(Uint32Array.of(column.length).buffer), new Uint8Array(Float32Array.from(positions).buffer),
    Uint8Array.from(colours), new Uint8Array(Float32Array.from(column).buffer),
  ];
  const parts = [
    new TextEncoder().encode("DCP1"), new Uint8Array(Uint32Array.of(200).buffer), text,
    ...block([1, 2, 3, 4, 5, 6], [9, 8, 7, 255, 6, 5, 4, 255], [0.5, 1.5]), ...block([7, 8, 9], [1, 2, 3, 255], [2.5]),
  ];
  const bytes = change(Uint8Array.from(parts.flatMap(part => [...part])));
  return new ReadableStream({
    start(controller) {
      for (let at = 0; at < bytes.length; at += piece) controller.enqueue(bytes.subarray(at, at + piece));
      controller.close();
    },
  });
}

test("blocks come whole, however the answer is cut", async () => {
  for (const piece of [1, 3, 7, 64, 10_000]) {
    const { head, blocks } = await unpack(answer(piece));
    assert.deepEqual(head.anchor, [10, 20, 30]);
    const all = [];
    for await (const block of blocks) all.push(block);
    assert.deepEqual(all.map(block => block.count), [2, 1]);
    assert.deepEqual([...all[0].positions], [1, 2, 3, 4, 5, 6]);
    assert.deepEqual([...all[0].colours], [9, 8, 7, 255, 6, 5, 4, 255]);
    assert.deepEqual([...all[1].columns[0]], [2.5]);
  }
});

test("an answer that breaks off or is another's is an error", async () => {
  const read = async change => {
    const { blocks } = await unpack(answer(50, change));
    for await (const block of blocks) assert.ok(block.count);
  };
  await assert.rejects(read(bytes => bytes.subarray(0, bytes.length - 1)), /breaks off/);
  await assert.rejects(read(bytes => bytes.subarray(0, 100)), /breaks off/);
  await assert.rejects(read(bytes => bytes.with(0, 0)), /no packed cloud/);
  await assert.rejects(read(bytes => bytes.with(208, 200)), /do not fit/);
});
