// Making a cloud denser: as a job where the server keeps them, else as one request.

import { Away, Problem, ask, askBlob, askJson, eventsOf, isStopped, send } from "./server.js";

/**
 * A finished result, wherever it lies.
 * @typedef {{name: string, mediaType: string, blob: Blob|null, job: string|null, provenance: string, warnings: string[],
 *   points: number}} Result
 * @typedef {{fraction: number|null, text: string}} Progress
 * @typedef {{file: File, query: URLSearchParams, accept?: string, signal: AbortSignal, seconds: number|null,
 *   tell: (progress: Progress) => void, jobbed?: (id: string) => void}} Order
 */

const STAGES = {
  seeds: "Choosing patches", patches: "Gathering patches", units: "Making points", resample: "Choosing points",
  attributes: "Carrying attributes over",
};
/** Seconds before a server that is away is asked again: more each time, up to the last. */
const PAUSES = [1, 2, 4, 8];

const wait = (seconds, signal) => new Promise((resolve, reject) => {
  const stop = () => reject(new DOMException("stopped", "AbortError"));
  const timer = setTimeout(resolve, 1000 * seconds);
  signal.addEventListener("abort", () => { clearTimeout(timer); stop(); });
});

/** What the sender is told while the file goes up. */
const sending = tell => share => tell({ fraction: share < 1 ? share : null, text: share < 1 ? "Sending" : "Reading" });

/** Makes a file denser by a job, and waits for it. @param {Order} order @returns {Promise<Result>} */
export async function byJob(order) {
  const { file, query, accept, signal, tell, jobbed } = order;
  const { body } = await send(`jobs?${query}`, file, { accept, signal, sent: sending(tell) });
  const { id } = JSON.parse(await body.text());
  jobbed?.(id);
  return resultOf(await followed(id, signal, tell), file.name);
}

/** What a job that is done has made. @returns {Result} */
export function resultOf({ id, result, points_out: points }, name) {
  const { media_type: mediaType, provenance, warnings } = result;
  return { name, mediaType, blob: null, job: id, provenance, warnings, points };
}

/** Waits for the end of a job, over any absence of the server. */
export async function followed(id, signal, tell) {
  for (let pauses = 0; ;) {
    try {
      const { body } = await ask(`jobs/${id}/events`, { signal });
      for await (const { data } of eventsOf(body)) {
        pauses = 0;
        if (data.state === "done") return data;
        if (data.state === "failed") throw new Problem(data.problem?.status, data.problem || {});
        if (data.state === "cancelled") throw new DOMException("stopped", "AbortError");
        tell(toldOf(data));
      }
    } catch (error) {
      // A stream that breaks off is a TypeError of the browser's.
      if (error instanceof Problem && error.status !== 503 || isStopped(error)) throw error;
    }
    tell({ fraction: null, text: "The server does not answer; it is asked again" });
    await wait(PAUSES[Math.min(pauses++, PAUSES.length - 1)], signal);
  }
}

/** What is told of a job that is not over. @returns {Progress} */
export function toldOf({ state, position, progress }) {
  if (state === "queued") return { fraction: null, text: position ? `Waiting for ${position} others` : "Waiting" };
  const level = progress.levels > 1 && progress.stage ? `, level ${progress.level} of ${progress.levels}` : "";
  return { fraction: progress.fraction, text: `${STAGES[progress.stage] || "Finishing"}${level}` };
}

/** Makes a file denser by one request. @param {Order} order @returns {Promise<Result>} */
export async function byRequest({ file, query, accept, signal, seconds, tell }) {
  let timer;
  const working = () => {
    const start = performance.now();
    timer = setInterval(() => {
      const spent = (performance.now() - start) / 1000;
      // How far it is nobody tells: by what it was thought to take, and never quite to the end.
      tell({ fraction: seconds ? Math.min(0.97, spent / seconds) : null, text: `Working, ${Math.round(spent)} s` });
    }, 250);
  };
  const sent = share => share < 1 ? sending(tell)(share) : timer ?? working();
  try {
    const { body, headers } = await send(`upsample?${query}`, file, { accept, signal, sent });
    return {
      name: file.name, blob: body, job: null,
      mediaType: headers.get("content-type") || "",
      provenance: headers.get("densecloud-provenance") || "",
      warnings: (headers.get("densecloud-warning") || "").split(", ").filter(Boolean),
      points: Number(headers.get("densecloud-points-out")),
    };
  } finally {
    clearInterval(timer);
  }
}

/** Whether any first part of a result is spread evenly, so that it need not be shuffled: where it was made as a whole. */
const isEven = result => !result.provenance.includes("tile_points=");

/** The packed points of a result. */
export function pointsOf(result, limit) {
  const query = new URLSearchParams({ limit: String(limit), order: isEven(result) ? "file" : "shuffled" });
  if (result.job) return ask(`jobs/${result.job}/points?${query}`);
  return ask(`points?${query}`, { method: "POST", body: result.blob });
}

/** The file of a result or of an input, in a format, and what of it lies in a box. */
export function fileOf({ job, blob, mediaType }, accept, bounds) {
  const query = bounds ? `?bounds=${bounds.join(",")}` : "";
  const isItself = !bounds && (!accept || accept === mediaType);
  const headers = { accept: accept || mediaType || "*/*" };
  if (job) return isItself ? askBlob(`jobs/${job}/result`) : askBlob(`jobs/${job}/points${query}`, { headers });
  return isItself ? Promise.resolve(blob) : askBlob(`points${query}`, { method: "POST", body: blob, headers });
}

/** How many points there will be, and in how many seconds. */
export const estimate = (points, ratio, isBest) =>
  askJson(`estimate?${new URLSearchParams({ points_in: points, ratio, quality: isBest ? "best" : "standard" })}`);

export const cancel = id => ask(`jobs/${id}`, { method: "DELETE" });

export { Away };
