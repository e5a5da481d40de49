// What is open, and what is made of it: a file, its cloud, its result, and what is being waited for.

import { Cloud } from "./cloud.js";
import { byId, duration, save, whole } from "./dom.js";
import { keepName, nameOf } from "./jobs.js";
import { fail, say, tell, tellFacts, warn } from "./messages.js";
import { unpack } from "./packed.js";
import { ask, askBlob } from "./server.js";
import { byJob, byRequest, cancel, estimate, fileOf, pointsOf, resultOf } from "./work.js";

/** Milliseconds until a server that has measured nothing yet is asked again how long work takes. */
const AGAIN = 2000;

const ratio = () => Number(byId("ratio").value);

export class Session {
  /**
   * @param {{view: import("./view.js").View, box: import("./box.js").Box, shown: (slot: string) => void,
   *   closed: () => void}} page
   */
  constructor(page) {
    this.page = page;
    this.about = null;
    /** @type {File|null} */
    this.file = null;
    /** The number of the file, if it is one of this server's. @type {string|null} */
    this.number = null;
    /** @type {Cloud|null} */
    this.before = null;
    /** @type {import("./work.js").Result|null} */
    this.result = null;
    /** @type {AbortController|null} */
    this.reading = null;
    /** @type {AbortController|null} */
    this.working = null;
    this.seconds = null;
    this.lookAtJobs = () => {};
  }

  /** Opens a file: shows it at once. */
  async openFile(file, number = null) {
    const reading = this.#begin();
    this.#close("before");
    this.#close("after");
    Object.assign(this, { file, number });
    byId("title").textContent = file.name;
    this.page.closed();
    this.tellDownload();
    say(`Reading ${file.name}`);
    try {
      const query = new URLSearchParams({ limit: byId("most").value });
      const reply = await ask(`points?${query}`, { method: "POST", body: file, signal: reading.signal });
      this.before = await this.#show(reply, file.name, "before", reading.signal);
    } catch (error) {
      byId("drop").hidden = this.page.view.drawnClouds().length > 0;
      fail(error);
    }
    this.#setWorking(this.working);
    this.tellEstimate();
  }

  /** Opens one of this server's files. */
  async openNumber(number) {
    const told = this.about.files[number];
    if (!told) return;
    byId("files").value = number;
    say(`Fetching ${told.name}`);
    await this.openFile(new File([await askBlob(`files/${number}`)], told.name), number);
  }

  /** Shows the result of a job; beside its input, if that is open, since the server keeps it no longer. */
  async openJob(job) {
    const reading = this.#begin(), result = resultOf(job, nameOf(job.id));
    if (this.file?.name !== result.name) {
      this.#close("before");
      byId("title").textContent = result.name;
    }
    this.#close("after");
    try {
      await this.#showResult(result, reading.signal);
    } catch (error) {
      fail(error);
    }
    this.#setWorking(null);
  }

  /** Stops whatever goes on, for something else. */
  #begin() {
    this.stop();
    this.reading?.abort();
    return this.reading = new AbortController();
  }

  #close(slot) {
    this.page.view.place(slot, null);
    if (slot === "before") Object.assign(this, { before: null, file: null, number: null });
    else this.result = null;
  }

  /** Shows packed points in a place while they come. */
  async #show(reply, name, slot, signal) {
    const { head, blocks } = await unpack(reply.body);
    const cloud = new Cloud(name, head), { view } = this.page;
    view.place(slot, cloud);
    for await (const block of blocks) {
      signal.throwIfAborted();
      cloud.add(block);
      view.add(slot, block);
      if (cloud.blocks.length === 1) this.#begun(slot, cloud);
      say(cloud.count < head.sent ? `Showing ${whole(cloud.count)} of ${whole(head.sent)} points` : "");
    }
    return cloud;
  }

  /** The first points of a cloud are there. */
  #begun(slot, cloud) {
    byId("drop").hidden = true;
    if (slot === "before" || !this.before) {
      tellFacts(cloud);
      warn(cloud.head.warnings);
      this.page.view.fit();
    }
    this.page.shown(slot);
  }

  /** What upsampling would give and take. */
  async tellEstimate() {
    const told = byId("estimate"), points = this.before?.head.points;
    const asked = this.estimating = {};
    if (!points || !(ratio() >= 1 && ratio() <= 64)) {
      told.textContent = "";
      return;
    }
    const answer = await estimate(points, ratio(), byId("best").checked).catch(fail);
    // Another question was asked meanwhile.
    if (!answer || asked !== this.estimating) return;
    const { points_out: made, seconds } = answer, { points_out: most } = this.about.limits;
    this.seconds = seconds;
    const time = seconds === null ? "" : `, ${duration(seconds)}`;
    told.textContent = `${whole(made)} points${time}${made > most ? `: more than this server makes (${whole(most)})` : ""}`;
    if (seconds === null) setTimeout(() => asked === this.estimating && this.tellEstimate(), AGAIN);
  }

  /** The parameters that the form asks for. */
  #wanted() {
    const query = new URLSearchParams({ ratio: byId("ratio").value });
    if (byId("best").checked) query.set("quality", "best");
    if (byId("confidence").checked) query.set("confidence", "true");
    if (byId("normals").checked) query.set("normals", "estimate");
    if (byId("keep").checked) query.set("keep_input", "true");
    const sides = this.page.box.sides();
    if (byId("boxed").checked && sides) query.set("bounds", sides.join(","));
    return query;
  }

  /** Makes the open file denser. */
  async upsample() {
    const { file } = this;
    if (!file || this.working) return;
    const working = new AbortController(), { signal } = working;
    this.#setWorking(working);
    say("");
    let job = null;
    const jobbed = id => {
      job = id;
      keepName(id, file.name);
      this.lookAtJobs();
    };
    signal.addEventListener("abort", () => job && cancel(job).catch(() => {}));
    try {
      const accept = byId("format").value || undefined;
      const order = { file, query: this.#wanted(), accept, signal, seconds: this.seconds, tell, jobbed };
      const result = await (this.about.jobs ? byJob(order) : byRequest(order));
      job = null;
      await this.#showResult(result, signal);
    } catch (error) {
      fail(error);
    }
    if (this.working === working) this.#setWorking(null);
    this.lookAtJobs();
  }

  async #showResult(result, signal) {
    // It can be saved even where it cannot be shown.
    this.result = result;
    this.tellDownload();
    tell({ fraction: null, text: "Loading the result" });
    const cloud = await this.#show(await pointsOf(result, byId("most").value), result.name, "after", signal);
    warn([...result.warnings, ...cloud.head.warnings]);
    say(`${whole(result.points)} points are there.`);
  }

  stop() {
    this.working?.abort();
    this.#setWorking(null);
  }

  /** What is at work, or nothing. */
  #setWorking(controller) {
    this.working = controller;
    byId("go").disabled = controller !== null || this.before === null;
    byId("stop").hidden = controller === null;
    if (controller !== null) return;
    byId("progress").hidden = true;
    byId("stage-name").textContent = "";
  }

  /** What would be saved. */
  #source() {
    const file = this.file && { name: this.file.name, blob: this.file, job: null, mediaType: "" };
    return this.result || file;
  }

  tellDownload() {
    const isCut = this.page.box.sides() !== null, source = this.#source();
    byId("download").disabled = !source;
    byId("download").textContent = this.result ? "Download result" : "Download";
    byId("download-told").textContent = source && isCut ? "Only what is in the box." : "";
  }

  async download() {
    const source = this.#source(), accept = byId("format").value;
    if (!source) return;
    byId("download").disabled = true;
    say("Preparing the file");
    try {
      const blob = await fileOf(source, accept, this.page.box.sides());
      save(blob, this.#nameOf(source, blob.type || accept));
      say("");
    } catch (error) {
      fail(error);
    }
    this.tellDownload();
  }

  /** The name of a file to be saved: the input's, `-dense` where it is a result, and the format's ending. */
  #nameOf({ name, mediaType }, kind) {
    const essence = text => text.split(";")[0].trim();
    const format = this.about.formats.find(({ media_type }) => essence(media_type) === essence(kind || mediaType));
    if (!format) return name;
    if (!format.name.startsWith("cloud.")) return format.name;
    return `${name.replace(/\.[^.]*$/, "")}${this.result ? "-dense" : ""}${format.name.slice("cloud".length)}`;
  }
}
