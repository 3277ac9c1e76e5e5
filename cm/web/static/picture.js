// SPDX-License-Identifier: Apache-2.0
// A frame on a canvas.

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

// The least and the greatest of each column, as an oscilloscope draws it.
function signal(canvas, header, payload) {
  resize(canvas, 1024, 320);
  const context = canvas.getContext("2d");
  const count = header.columns;
  const values = new Float32Array(payload.slice().buffer);
  const [low, high] = header.range;
  const y = (value) => 310 - ((value - low) / (high - low || 1)) * 300;
  const x = (column) => ((column + 0.5) / count) * 1024;
  context.fillStyle = "#0b1512";
  context.fillRect(0, 0, 1024, 320);
  context.strokeStyle = "#1d3a31";
  context.beginPath();
  for (let line = 0; line <= 8; line++) {
    context.moveTo(0, line * 40);
    context.lineTo(1024, line * 40);
    context.moveTo(line * 128, 0);
    context.lineTo(line * 128, 320);
  }
  context.stroke();
  context.strokeStyle = "#7fe0c3";
  context.lineWidth = 1.5;
  context.beginPath();
  for (let i = 0; i < count; i++) {
    if (i) context.lineTo(x(i), y(values[i]));
    else context.moveTo(x(0), y(values[0]));
    context.lineTo(x(i), y(values[count + i]));
  }
  context.stroke();
}
