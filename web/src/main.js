// The page: its parts, and what a person does about them.

import { Box } from "./box.js";
import { Comparison } from "./comparison.js";
import { byId, make } from "./dom.js";
import { watchJobs } from "./jobs.js";
import { bindKeys } from "./keys.js";
import { fragmentOf, keptIn } from "./link.js";
import { Look } from "./look.js";
import { askForKey, fail, say } from "./messages.js";
import { Ruler } from "./ruler.js";
import { askJson, keepKey } from "./server.js";
import { Session } from "./session.js";
import { View } from "./view.js";

/** What can be chosen as the most points that are shown, and how many these are at first, by the size of the screen. */
const MOST = [500_000, 2_000_000, 5_000_000, 10_000_000, 20_000_000];
const PHONE = "(max-width: 46rem)";
/** Pixels that a pointer may move between down and up, to have clicked. */
const STILL = 6;

const view = new View(byId("canvas"));
const look = new Look(view);
const comparison = new Comparison(view);
const ruler = new Ruler(view);
const box = new Box(view, () => session.tellDownload());
const session = new Session({ view, box, shown, closed });
let kept = keptIn(location.hash);

/** A cloud has begun to show. */
function shown(slot) {
  look.offer();
  comparison.offer();
  restore(slot);
}

function closed() {
  ruler.toggle(false);
  box.reset();
}

/** Brings back what a link has kept, once: the camera with the first cloud, the comparison with the second. */
function restore(slot) {
  if (slot === "before" || !view.slots.before) restoreLook();
  if (!view.slots.before || !view.slots.after) return;
  if (kept.compare) comparison.choose(kept.compare);
  if (kept.split !== undefined) comparison.moveTo(kept.split);
  kept = keptIn("");
}

function restoreLook() {
  const { up, size, colour, box: sides, from, to, compare, split } = kept;
  if (up !== undefined) look.setUp(up);
  if (size !== undefined) look.setSize(size);
  if (colour) look.choose(colour);
  if (sides) box.set(sides);
  if (from && to) {
    view.camera.position.copy(view.toScene(from));
    view.controls.target.copy(view.toScene(to));
    view.controls.update();
  }
  kept = { ...keptIn(""), compare, split };
}

async function copyLink() {
  const fragment = fragmentOf({
    from: view.toFile(view.camera.position),
    to: view.toFile(view.controls.target),
    up: byId("up").value,
    colour: look.colouring,
    compare: view.comparison,
    split: view.split,
    size: view.pointSize,
    box: box.sides(),
    job: session.result?.job || null,
    file: session.number,
  });
  history.replaceState(null, "", `#${fragment}`);
  // Only pages of this machine, or behind TLS, may write there; the address has it anyhow.
  await navigator.clipboard?.writeText(location.href).catch(() => {});
  const isWhole = session.result?.job || session.number !== null;
  say(isWhole ? "The link is copied." : "The link is copied. It keeps the view; the file stays with you: open it there, too.");
}

/** Opens what the address names, or the first file of this server. */
async function openNamed() {
  if (kept.job) return session.openJob(await askJson(`jobs/${kept.job}`));
  const number = kept.file ?? (session.about.files.length > 0 ? "0" : null);
  if (number !== null) await session.openNumber(number);
}

function fillForm({ formats, files, version }) {
  const ending = name => name.startsWith("cloud.") ? name.slice("cloud.".length).toUpperCase() : name;
  byId("format").replaceChildren(
    make("option", { value: "" }, "as the input"),
    ...formats.map(({ media_type: value, name }) => make("option", { value }, ending(name))),
  );
  byId("files").hidden = files.length === 0;
  byId("files").replaceChildren(...files.map(({ name }, i) => make("option", { value: String(i) }, name)));
  byId("title").title = `densecloud ${version}`;
}

async function start() {
  try {
    session.about = await askJson("about");
    fillForm(session.about);
    if (session.about.jobs) session.lookAtJobs = watchJobs(job => session.openJob(job), fail);
    await openNamed();
  } catch (error) {
    fail(error);
    if (error.status === 401) askForKey(start);
  }
}

/** Opens a file that a person has chosen or dropped; a server that was away before tells of itself now. */
async function openFile(file) {
  if (!file) return;
  if (!session.about) await start();
  if (session.about) session.openFile(file);
}

function bindFiles() {
  const stage = byId("stage");
  byId("file").addEventListener("change", event => {
    openFile(event.target.files[0]);
    event.target.value = "";
  });
  for (const name of ["dragenter", "dragover"]) {
    document.addEventListener(name, event => {
      event.preventDefault();
      stage.classList.add("over");
    });
  }
  document.addEventListener("dragleave", event => { if (!event.relatedTarget) stage.classList.remove("over"); });
  document.addEventListener("drop", event => {
    event.preventDefault();
    stage.classList.remove("over");
    openFile(event.dataTransfer?.files[0]);
  });
  byId("files").addEventListener("change", event => session.openNumber(event.target.value).catch(fail));
}

function bindWork() {
  const number = byId("ratio"), range = byId("ratio-range");
  number.addEventListener("input", () => {
    range.value = Math.log2(Number(number.value) || 1);
    session.tellEstimate();
  });
  range.addEventListener("input", () => {
    number.value = +(2 ** range.value).toFixed(2);
    session.tellEstimate();
  });
  byId("best").addEventListener("change", () => session.tellEstimate());
  byId("work").addEventListener("submit", event => {
    event.preventDefault();
    session.upsample();
  });
  byId("stop").addEventListener("click", () => session.stop());
  byId("download").addEventListener("click", () => session.download());
}

function bindTools() {
  byId("link").addEventListener("click", copyLink);
  byId("fit").addEventListener("click", () => view.fit());
  byId("measure").addEventListener("click", () => ruler.toggle());
  byId("box").addEventListener("click", () => box.toggle());
  const canvas = byId("canvas");
  let from = null;
  canvas.addEventListener("pointerdown", ({ offsetX: x, offsetY: y }) => { from = { x, y }; });
  canvas.addEventListener("pointerup", ({ offsetX: x, offsetY: y }) => {
    if (from && ruler.isOn && Math.hypot(x - from.x, y - from.y) < STILL) ruler.take(x, y);
    from = null;
  });
}

/** Takes a key out of the address: it is no part of what is shown, kept or copied. */
function takeKey() {
  if (!kept.key) return;
  keepKey(kept.key);
  const fields = new URLSearchParams(location.hash.slice(1));
  fields.delete("key");
  history.replaceState(null, "", fields.size > 0 ? `#${fields}` : location.pathname);
}

function begin() {
  takeKey();
  const most = matchMedia(PHONE).matches ? MOST[0] : MOST[2];
  const choice = points => make("option", { value: points, selected: points === most }, `${points / 1e6} M`);
  byId("most").replaceChildren(...MOST.map(choice));
  bindFiles();
  bindWork();
  bindTools();
  bindKeys({
    view, look, comparison, ruler, box,
    openFile: () => byId("file").click(),
    upsample: () => byId("work").requestSubmit(),
    download: () => session.download(),
  });
  start();
}

begin();
