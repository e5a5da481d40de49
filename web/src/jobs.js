// The list of the client's jobs.

import { byId, make, whole } from "./dom.js";
import { askJson } from "./server.js";
import { cancel, toldOf } from "./work.js";

/** Milliseconds between two looks at the list, while something goes on and while nothing does. */
const SOON = 2000, LATER = 15_000;
const SHOWN = 20;
const NAMES = "densecloud-jobs";

const names = () => JSON.parse(localStorage.getItem(NAMES) || "{}");

/** Keeps the name of a job's file in this browser: the server is not told. */
export function keepName(id, name) {
  const last = Object.entries({ ...names(), [id]: name }).slice(-100);
  localStorage.setItem(NAMES, JSON.stringify(Object.fromEntries(last)));
}

export const nameOf = id => names()[id] || `job-${id.slice(0, 8)}`;

/** Shows the jobs and goes on doing so. `open` is called with one that is done. */
export function watchJobs(open, failed) {
  let timer;
  async function look() {
    clearTimeout(timer);
    let wait = LATER;
    try {
      const { jobs } = await askJson(`jobs?limit=${SHOWN}`);
      byId("jobs").replaceChildren(...jobs.map(job => row(job, open, act)));
      if (jobs.some(({ state }) => state === "queued" || state === "running")) wait = SOON;
    } catch {
      // What is shown stays; the work itself tells of a server that is away.
    }
    timer = setTimeout(look, wait);
  }
  async function act(id) {
    await cancel(id).catch(failed);
    look();
  }
  byId("jobs-section").hidden = false;
  look();
  return look;
}

function row(job, open, act) {
  const { id, state, points_in: from, points_out: to, progress, problem } = job;
  const isOver = state !== "queued" && state !== "running";
  const told = isOver ? problem?.detail || state : toldOf(job).text;
  const buttons = [];
  if (state === "done") buttons.push(make("button", { type: "button", onclick: () => open(job) }, "Show"));
  buttons.push(make("button", { type: "button", onclick: () => act(id) }, isOver ? "Forget" : "Stop"));
  const bar = make("progress", { max: 1, hidden: state !== "running" });
  bar.value = progress.fraction;
  const line = make("div", { className: "row" }, make("span", { className: "what" }, nameOf(id)), ...buttons);
  return make("li", {}, line, make("small", {}, `${whole(from)} to ${whole(to)} points · ${told}`), bar);
}
