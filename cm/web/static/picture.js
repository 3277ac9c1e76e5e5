// SPDX-License-Identifier: Apache-2.0
// A frame on a canvas.

import { signal } from "./signal.js";

const GREY = Uint32Array.from({ length: 256 }, (_, value) => (0xff000000 | (value << 16) | (value << 8) | value) >>> 0);

export async function draw(canvas, header, payload) {
  if (header.kind === "signal") return signal(canvas, header, payload);
  if (header.kind === "empty") return undefined;
  resize(canvas, header.width, header.height);
  const context = canvas.getContext("2d");
  if (header.kind === "jpeg") {
    const image = await createImageBitmap(new Blob([payload], { type: "image/jpeg" }));
    context.drawImage(image, 0, 0);
    image.close();
    return undefined;
  }
  const image = context.createImageData(header.width, header.height);
  const out = new Uint32Array(image.data.buffer);
  if (header.kind === "grey") for (let i = 0; i < out.length; i++) out[i] = GREY[payload[i]];
  else for (let i = 0, j = 0; i < out.length; i++, j += 3) {
    out[i] = 0xff000000 | (payload[j + 2] << 16) | (payload[j + 1] << 8) | payload[j];
  }
  context.putImageData(image, 0, 0);
  return undefined;
}

function resize(canvas, width, height) {
  if (canvas.width !== width) canvas.width = width;
  if (canvas.height !== height) canvas.height = height;
}
