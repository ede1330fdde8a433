/**
 * Sources of the data of a page. A source has
 *
 *   content          object: title and items of the page
 *   blob(n)          promise of a Uint8Array: part n of the data
 *   canCompute       true if a device computes
 *   compute(request, channel, onProgress)
 *                    promise of {result, blobs}; rejects with an error, or with null if a newer
 *                    request of the channel replaced it
 *   missing()        sentence about missing parts, or null
 */

/** Decode base64. */
function bytesOf(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

const INCOMPLETE = "This page is incomplete: parts of its data are missing. Download the file again.";

/** Data embedded in the page. */
export class EmbeddedSource {
  canCompute = false;

  constructor(page = document) {
    this.page = page;
    this.content = JSON.parse(page.getElementById("clplen-content").textContent);
  }

  missing() {
    return this.page.getElementById("clplen-end") ? null : INCOMPLETE;
  }

  async blob(n) {
    const part = this.page.getElementById(`clplen-data-${n}`);
    let bytes = null;
    try {
      bytes = part && bytesOf(part.textContent.trim());
    } catch {
      // truncated within a group of four characters
    }
    if (!bytes || bytes.length !== this.content.sizes[n]) throw new Error(INCOMPLETE);
    return bytes;
  }
}

/** Data from the server of the page. */
export class ServerSource {
  canCompute = true;

  constructor(content) {
    this.content = content;
    this.page = Array.from(crypto.getRandomValues(new Uint8Array(12)), (b) =>
      b.toString(16).padStart(2, "0"),
    ).join("");
    this.stayOpen();
  }

  missing() {
    return null;
  }

  /** Keep a connection to the server while the page is open. */
  async stayOpen() {
    try {
      const answer = await fetch(`alive?page=${this.page}`);
      const reader = answer.body.getReader();
      while (!(await reader.read()).done);
    } catch {
      // the server has ended; the next request reports it
    }
  }

  async blob(n) {
    const answer = await reach(fetch(`data/${n}`));
    if (!answer.ok) throw new Error((await answer.text()).trim() || `Part ${n} of the data is missing.`);
    return new Uint8Array(await answer.arrayBuffer());
  }

  async compute(request, channel, onProgress) {
    const answer = await reach(
      fetch("compute", {
        method: "POST",
        headers: { "Content-Type": "application/json" },
        body: JSON.stringify({ page: this.page, channel, request }),
      }),
    );
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    let text = "";
    for (;;) {
      const { value, done } = await reader.read();
      text += value ?? "";
      const lines = text.split("\n");
      text = lines.pop();
      for (const line of lines.filter(Boolean)) {
        const message = JSON.parse(line);
        if (message.error) throw new Error(message.error);
        if (message.dropped) throw null;
        if (message.result)
          return { result: message.result, blobs: message.blobs.map((blob) => bytesOf(blob)) };
        onProgress?.(message.progress, message.what);
      }
      if (done) throw new Error(ENDED);
    }
  }
}

const ENDED = "clplen view has ended: start it again, or write a self-contained page with -o page.html.";

async function reach(promise) {
  try {
    return await promise;
  } catch {
    throw new Error(ENDED);
  }
}

async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Unpack 16-bit samples: gzip of row differences, first all low bytes, then all high bytes. */
export async function unpack16(bytes, width) {
  const split = await inflated(bytes);
  const count = split.length / 2;
  const samples = new Uint16Array(count);
  for (let i = 0; i < count; i++) {
    const difference = split[i] | (split[count + i] << 8);
    samples[i] = i % width ? samples[i - 1] + difference : difference;
  }
  return samples;
}

/** Decode an 8-bit picture in the browser, without colour management. */
export function bitmap(bytes) {
  return createImageBitmap(new Blob([bytes]), {
    colorSpaceConversion: "none",
    premultiplyAlpha: "none",
  });
}

/** Read a map of floats, {values, height, width}. */
export async function readMap(source, map) {
  const [height, width] = map.shape;
  return { values: await unpackFloats(await source.blob(map.blob)), height, width };
}

/** Unpack floats: gzip of all first bytes, then all second bytes, and so on. */
export async function unpackFloats(packed) {
  const split = await inflated(packed);
  const count = split.length / 4;
  const bytes = new Uint8Array(4 * count);
  for (let i = 0; i < count; i++) for (let b = 0; b < 4; b++) bytes[4 * i + b] = split[b * count + i];
  return new Float32Array(bytes.buffer);
}

export const MOST = 65534; // largest 16-bit level; the next level is NaN
