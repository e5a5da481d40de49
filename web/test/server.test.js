import assert from "node:assert/strict";
import { test } from "node:test";
import { eventsOf } from "../src/server.js";
import { toldOf } from "../src/work.js";

test("events are told apart, however they come", async () => {
  const text = `event: progress\ndata: {"a":1}\n\n: still here\n\nevent: done\ndata: {"a":"ö"}\n\nevent: cut`;
  const bytes = new TextEncoder().encode(text);
  for (const piece of [1, 5, 1000]) {
    const body = new ReadableStream({
      start(controller) {
        for (let at = 0; at < bytes.length; at += piece) controller.enqueue(bytes.subarray(at, at + piece));
        controller.close();
      },
    });
    const events = [];
    for await (const event of eventsOf(body)) events.push(event);
    assert.deepEqual(events, [{ name: "progress", data: { a: 1 } }, { name: "done", data: { a: "ö" } }]);
  }
});

test("a job that goes on is told of", () => {
  const progress = { stage: "units", level: 1, levels: 2, fraction: 0.25 };
  assert.deepEqual(toldOf({ state: "running", position: undefined, progress }), { fraction: 0.25, text: "Making points, level 1 of 2" });
  assert.equal(toldOf({ state: "queued", position: 3, progress }).text, "Waiting for 3 others");
  assert.equal(toldOf({ state: "running", position: undefined, progress: { ...progress, stage: null } }).text, "Finishing");
});
