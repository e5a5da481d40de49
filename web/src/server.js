// What is asked of the server, and what it says.

/** What the server refuses, in its own words (`application/problem+json`). */
export class Problem extends Error {
  /** @param {number} status @param {{title?: string, detail?: string, type?: string}} told */
  constructor(status, told) {
    super(told.detail || told.title || `the server answered with ${status}`);
    this.status = status;
    this.title = told.title || `Status ${status}`;
    this.kind = (told.type || "").split(":").pop();
  }
}

/** Nobody answers, or the answer breaks off. */
export class Away extends Error {
  constructor() {
    super("The server does not answer. What is shown stays; try again when it is back.");
  }
}

const KEY = "densecloud-key";
/** How often a server that has just been started is asked again, a second apart. */
const WARMING = 60;

/** The media type of points that are packed to be shown. */
export const PACKED = "application/vnd.densecloud.points";

/** Keeps a key for this tab alone. */
export function keepKey(key) {
  sessionStorage.setItem(KEY, key);
}

/** @returns {Record<string, string>} */
function withKey(headers = {}) {
  const key = sessionStorage.getItem(KEY);
  return key ? { ...headers, authorization: `Bearer ${key}` } : headers;
}

/** What a refusal says; a proxy's own page says nothing. */
async function problemOf(reply) {
  const told = await reply.json().catch(() => ({}));
  return new Problem(reply.status, told);
}

/** Whether somebody has stopped waiting. */
export const isStopped = error => error instanceof DOMException && error.name === "AbortError";

/**
 * An answer that is one.
 * @param {string} path relative to the page
 * @param {RequestInit & {headers?: Record<string, string>}} [request]
 */
export async function ask(path, request = {}) {
  for (let tries = 0; ; tries++) {
    try {
      return await askOnce(path, request);
    } catch (error) {
      if (error.kind !== "warming-up" || tries === WARMING) throw error;
      await new Promise(resolve => setTimeout(resolve, 1000));
    }
  }
}

async function askOnce(path, request) {
  let reply;
  try {
    reply = await fetch(path, { ...request, headers: withKey(request.headers) });
  } catch (error) {
    throw isStopped(error) ? error : new Away();
  }
  if (!reply.ok) throw await problemOf(reply);
  return reply;
}

export const askJson = async (path, request) => (await ask(path, request)).json();

/** The body of an answer as a file in the browser. */
export async function askBlob(path, request) {
  const reply = await ask(path, request);
  try {
    return await reply.blob();
  } catch (error) {
    throw isStopped(error) ? error : new Away();
  }
}

/** Headers of an answer, by their names. */
function headersOf(request) {
  const lines = request.getAllResponseHeaders().trim().split(/\r?\n/);
  return new Headers(lines.filter(Boolean).map(line => {
    const at = line.indexOf(":");
    return [line.slice(0, at), line.slice(at + 1).trim()];
  }));
}

/**
 * Sends a file and waits for all of the answer; as `ask`, but it tells how much has been sent, which `fetch` does not.
 * @param {string} path
 * @param {Blob} file
 * @param {{accept?: string, signal: AbortSignal, sent: (share: number) => void}} how
 * @returns {Promise<{body: Blob, headers: Headers}>}
 */
export function send(path, file, { accept, signal, sent }) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", path);
    request.responseType = "blob";
    const headers = withKey(accept ? { accept } : {});
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    request.upload.onprogress = event => sent(event.total ? event.loaded / event.total : 0);
    request.upload.onload = () => sent(1);
    request.onerror = () => reject(new Away());
    request.onabort = () => reject(new DOMException("stopped", "AbortError"));
    request.onload = async () => {
      const { status, response: body } = request;
      if (status >= 200 && status < 300) resolve({ body, headers: headersOf(request) });
      else reject(await problemOf(new Response(body, { status })));
    };
    signal.addEventListener("abort", () => request.abort());
    request.send(file);
  });
}

/**
 * The events of a stream, each with its name and its data in JSON.
 * @param {ReadableStream<Uint8Array>} body
 */
export async function* eventsOf(body) {
  const reader = body.getReader(), decoder = new TextDecoder();
  let text = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    text += decoder.decode(value, { stream: true });
    const events = text.split("\n\n");
    text = events.pop() || "";
    for (const event of events) {
      const field = name => event.split("\n").find(line => line.startsWith(`${name}: `))?.slice(name.length + 2);
      const data = field("data");
      if (data) yield { name: field("event"), data: JSON.parse(data) };
    }
  }
}
