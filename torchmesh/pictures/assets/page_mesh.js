// The stages of a mesh: unpacked from the page, measured, searched, painted.  Knows canvases, but nothing of the page.
//
// World coordinates are steps of the header's grid, y up; screen coordinates are device pixels, y down.
"use strict";

// --- data -----------------------------------------------------------------------------------------

async function inflate(text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Undoes page_data.encode: bytes by weight, exclusive-or with the stage before where the lengths agree.
function unpack(header, bytes) {
  let offset = 0;
  const take = (kind, count, before) => {
    const width = kind.BYTES_PER_ELEMENT;
    const values = new kind(count);
    for (let b = 0; b < width; b++) {
      for (let i = 0; i < count; i++) values[i] |= bytes[offset + b * count + i] << (8 * b);
    }
    offset += width * count;
    if (before && before.length === count) for (let i = 0; i < count; i++) values[i] ^= before[i];
    return values;
  };
  const stages = [];
  let last = {};
  for (const { vertices, triangles, quads, interfaces, curves, name, label } of header.stages) {
    const grid = take(Uint32Array, 2 * vertices, last.grid);
    const corners = take(Uint32Array, 3 * triangles, last.corners);
    const codes = take(Uint16Array, triangles, last.codes);
    const flags = take(Uint8Array, (triangles + 7) >> 3, last.flags);
    const walls = take(Uint32Array, 2 * interfaces, last.walls);
    const bends = take(Uint32Array, 2 * curves, last.bends);
    const controls = take(Uint32Array, 2 * curves, last.controls);
    const whole = triangles - 2 * (quads || 0);
    last = { name, label, grid, corners, codes, flags, walls, bends, controls, count: triangles, whole };
    stages.push(last);
  }
  return stages;
}

const isInverted = (stage, t) => ((stage.flags[t >> 3] >> (t & 7)) & 1) === 1;

// Positions as numbers, unique edges and the order from worst to best: made when a stage is first shown.
function prepare(stage) {
  if (stage.points) return stage;
  const { grid, corners, count } = stage;
  stage.points = Float64Array.from(grid);
  const vertices = grid.length / 2;
  const keys = new Float64Array(3 * count);
  for (let t = 0; t < count; t++) {
    for (let k = 0; k < 3; k++) {
      const u = corners[3 * t + k], v = corners[3 * t + ((k + 1) % 3)];
      // The last edge of a half of a quad is the quad's diagonal, which is no edge of the mesh.
      const diagonal = t >= stage.whole && k === 2;
      keys[3 * t + k] = diagonal ? Infinity : Math.min(u, v) * vertices + Math.max(u, v);
    }
  }
  keys.sort();
  const inner = [], boundary = [];
  for (let i = 0; i < keys.length && keys[i] < Infinity; ) {
    let j = i + 1;
    while (j < keys.length && keys[j] === keys[i]) j++;
    (j - i === 1 ? boundary : inner).push(Math.floor(keys[i] / vertices), keys[i] % vertices);
    i = j;
  }
  // Edges that are curved, by their ends, and the triangles at them.
  stage.bendOf = new Map();
  for (let i = 0; i < stage.bends.length; i += 2) stage.bendOf.set(stage.bends[i] * vertices + stage.bends[i + 1], i);
  stage.bent = [];
  for (let t = 0; stage.bendOf.size && t < count; t++) {
    const sides = [0, 1, 2].map((k) => bendAt(stage, corners[3 * t + k], corners[3 * t + ((k + 1) % 3)]));
    if (sides.some((side) => side >= 0)) stage.bent.push(t);
  }
  stage.inner = Uint32Array.from(inner);
  stage.boundary = Uint32Array.from(boundary);
  const rank = (t) => stage.codes[t] + (isInverted(stage, t) ? 65536 : 0);
  // Of a quad one half stands for both.
  const elements = Uint32Array.from({ length: count }, (_, t) => t).filter((t) => t < stage.whole || (t - stage.whole) % 2 === 0);
  stage.worst = elements.sort((s, t) => rank(t) - rank(s) || s - t);
  return stage;
}

// Where the control point of a curved edge stands; -1 for a straight one.
function bendAt({ bendOf, grid }, u, v) {
  const at = bendOf.get((Math.min(u, v) * grid.length) / 2 + Math.max(u, v));
  return at === undefined ? -1 : at;
}

function extentOf(stages) {
  let x0 = Infinity, y0 = Infinity, x1 = -Infinity, y1 = -Infinity;
  for (const { grid } of stages) {
    for (let i = 0; i < grid.length; i += 2) {
      x0 = Math.min(x0, grid[i]); x1 = Math.max(x1, grid[i]);
      y0 = Math.min(y0, grid[i + 1]); y1 = Math.max(y1, grid[i + 1]);
    }
  }
  return { x0, y0, x1, y1, size: Math.max(x1 - x0, y1 - y0) || 1 };
}

// --- one triangle ---------------------------------------------------------------------------------

function cornersOf({ points, corners }, t) {
  const a = 2 * corners[3 * t], b = 2 * corners[3 * t + 1], c = 2 * corners[3 * t + 2];
  return [points[a], points[a + 1], points[b], points[b + 1], points[c], points[c + 1]];
}

function smallestAngle([ax, ay, bx, by, cx, cy]) {
  const angle = (x, y, u, v) => Math.abs(Math.atan2(x * v - y * u, x * u + y * v));
  const all = [angle(bx - ax, by - ay, cx - ax, cy - ay), angle(ax - bx, ay - by, cx - bx, cy - by), angle(ax - cx, ay - cy, bx - cx, by - cy)];
  return (Math.min(...all) * 180) / Math.PI;
}

const signedArea = ([ax, ay, bx, by, cx, cy]) => ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax)) / 2;

// The triangle at a position: an inverted one before others, then the smallest; -1: none.
function triangleAt(stage, x, y) {
  let best = -1, bestRank = Infinity;
  for (let t = 0; t < stage.count; t++) {
    const [ax, ay, bx, by, cx, cy] = cornersOf(stage, t);
    const p = (bx - ax) * (y - ay) - (by - ay) * (x - ax);
    const q = (cx - bx) * (y - by) - (cy - by) * (x - bx);
    const r = (ax - cx) * (y - cy) - (ay - cy) * (x - cx);
    if ((p < 0 || q < 0 || r < 0) && (p > 0 || q > 0 || r > 0)) continue;
    const rank = Math.abs(p + q + r) * (isInverted(stage, t) ? 1e-30 : 1);
    if (rank < bestRank) { best = t; bestRank = rank; }
  }
  return best;
}

// --- pixels ---------------------------------------------------------------------------------------

const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
const pixel = (c) => (255 << 24) | (Math.round(c[2]) << 16) | (Math.round(c[1]) << 8) | Math.round(c[0]);

// The pixel colour of a quality code.
function colourScale({ colours, worstShown, codesADoubling }, shades = 64) {
  const ramp = Int32Array.from({ length: shades }, (_, i) => {
    const { shapes } = colours;
    const position = (i / (shades - 1)) * (shapes.length - 1);
    const k = Math.min(Math.floor(position), shapes.length - 2);
    const [a, b] = [rgb(shapes[k]), rgb(shapes[k + 1])];
    return pixel(a.map((v, j) => v + (position - k) * (b[j] - v)));
  });
  const top = codesADoubling * Math.log2(worstShown);
  return (code) => ramp[Math.min(shades - 1, Math.floor((code / top) * shades))];
}

// All pixels whose centres lie inside, row by row; neighbours share no pixel and leave none out.  With a period, every
// so many pixels slanting stripes have another colour, a third as wide as the period.
function fillTriangle(pixels, width, height, ax, ay, bx, by, cx, cy, colour, stripe = colour, period = 0) {
  let s;
  if (by < ay) { s = ax; ax = bx; bx = s; s = ay; ay = by; by = s; }
  if (cy < by) { s = bx; bx = cx; cx = s; s = by; by = cy; cy = s; }
  if (by < ay) { s = ax; ax = bx; bx = s; s = ay; ay = by; by = s; }
  const last = Math.min(height, Math.ceil(cy - 0.5));
  for (let y = Math.max(0, Math.ceil(ay - 0.5)); y < last; y++) {
    const line = y + 0.5;
    const p = ax + ((cx - ax) * (line - ay)) / (cy - ay);
    const q = line < by ? ax + ((bx - ax) * (line - ay)) / (by - ay) : bx + ((cx - bx) * (line - by)) / (cy - by);
    const from = Math.max(0, Math.ceil((p < q ? p : q) - 0.5));
    const to = Math.min(width, Math.ceil((p < q ? q : p) - 0.5));
    if (!period) for (let i = y * width + from, end = y * width + to; i < end; i++) pixels[i] = colour;
    else for (let x = from; x < to; x++) pixels[y * width + x] = 3 * ((x + y) % period) < period ? stripe : colour;
  }
}

// One pixel wide, a step along the longer side; for lines on or near the screen.
function drawLine(pixels, width, height, ax, ay, bx, by, colour) {
  const steps = Math.ceil(Math.max(Math.abs(bx - ax), Math.abs(by - ay))) || 1;
  const dx = (bx - ax) / steps, dy = (by - ay) / steps;
  for (let i = 0; i <= steps; i++) {
    const x = Math.floor(ax + i * dx), y = Math.floor(ay + i * dy);
    if (x >= 0 && y >= 0 && x < width && y < height) pixels[y * width + x] = colour;
  }
}

function drawDot(pixels, width, height, x, y, radius, colour) {
  const right = Math.min(width, Math.round(x + radius)), low = Math.min(height, Math.round(y + radius));
  for (let j = Math.max(0, Math.round(y - radius)); j < low; j++) {
    for (let i = Math.max(0, Math.round(x - radius)); i < right; i++) pixels[j * width + i] = colour;
  }
}

// --- painting -------------------------------------------------------------------------------------

// More inverted triangles than this are drawn without outlines: outlines would hide the mesh and cost time.
const OUTLINED = 500;

// Paint a stage and return the number of triangles in sight.
//   view  x, y: the world at the canvas's middle; scale: pixels to a grid step; ratio: pixels to a CSS pixel
//   look  shade: code to pixel colour; colours: those of palette.py; edges: draw them; selected: row or -1
function paint(canvas, stage, view, look) {
  const context = canvas.getContext("2d");
  const { width, height } = canvas;
  if (!canvas.image || canvas.image.width !== width || canvas.image.height !== height) {
    canvas.image = context.createImageData(width, height);
    canvas.pixels = new Int32Array(canvas.image.data.buffer);
  }
  const { pixels } = canvas, { corners, codes, count } = stage;
  const screen = toScreen(stage.points, view, width, height);
  const dot = 2.5 * view.ratio, vermilion = pixel(rgb(look.colours.inverted)), dark = pixel(rgb(look.colours.outline));
  const small = [], large = [];
  let seen = 0, sizes = 0;
  pixels.fill(pixel(rgb(look.colours.canvas)));
  for (let t = 0; t < count; t++) {
    const a = 2 * corners[3 * t], b = 2 * corners[3 * t + 1], c = 2 * corners[3 * t + 2];
    const ax = screen[a], ay = screen[a + 1], bx = screen[b], by = screen[b + 1], cx = screen[c], cy = screen[c + 1];
    const left = Math.min(ax, bx, cx), right = Math.max(ax, bx, cx), top = Math.min(ay, by, cy), low = Math.max(ay, by, cy);
    if (right < 0 || left > width || low < 0 || top > height) continue;
    const size = Math.max(right - left, low - top);
    seen++;
    sizes += Math.min(size, width);
    if (isInverted(stage, t)) (size < 2 * dot ? small : large).push(t);
    else fillTriangle(pixels, width, height, ax, ay, bx, by, cx, cy, look.shade(codes[t]));
  }
  const many = small.length + large.length > OUTLINED;
  for (const t of large) {
    const [ax, ay, bx, by, cx, cy] = cornersOf({ points: screen, corners }, t);
    fillTriangle(pixels, width, height, ax, ay, bx, by, cx, cy, vermilion, dark, Math.round(7 * view.ratio));
    if (!many) continue;
    drawLine(pixels, width, height, ax, ay, bx, by, vermilion);
    drawLine(pixels, width, height, bx, by, cx, cy, vermilion);
    drawLine(pixels, width, height, cx, cy, ax, ay, vermilion);
  }
  // Those too small to see are dots, smaller ones where there are very many: the mesh must be seen between them.
  const radius = Math.max(0.5, Math.min(dot, Math.sqrt((0.05 * width * height) / (small.length + 1))));
  for (const t of small) {
    const [ax, ay, bx, by, cx, cy] = cornersOf({ points: screen, corners }, t);
    // With a dark rim, where there is room for one: it tells them in grey.
    if (radius > 1.5) drawDot(pixels, width, height, (ax + bx + cx) / 3, (ay + by + cy) / 3, radius + view.ratio, dark);
    drawDot(pixels, width, height, (ax + bx + cx) / 3, (ay + by + cy) / 3, radius, vermilion);
  }
  context.putImageData(canvas.image, 0, 0);
  const bends = { stage, controls: toScreen(stage.controls, view, width, height) };
  fillCurved(context, screen, bends, look);
  const edge = seen ? sizes / seen : 0, dense = 4 * view.ratio;
  if (look.edges && edge > dense) {
    const opacity = Math.min(0.8, edge / (8 * dense));
    strokeEdges(context, screen, stage.inner, `rgba(${rgb(look.colours.edge)},${opacity})`, view.ratio * Math.min(1, edge / (10 * dense) + 0.4), bends);
  }
  strokeEdges(context, screen, stage.boundary, look.colours.boundary, 1.2 * view.ratio, bends);
  const fine = view.ratio * Math.min(1, Math.max(0.4, edge / (16 * view.ratio)));
  strokeEdges(context, screen, stage.walls, look.colours.interfacePale, 3.6 * fine, bends);
  context.setLineDash([5 * fine, 4 * fine]);
  strokeEdges(context, screen, stage.walls, look.colours.interface, 1.8 * fine, bends);
  context.setLineDash([]);
  if (!many) strokeTriangles(context, screen, corners, large, look.colours.outline, 1.5 * view.ratio);
  look.places.forEach(([x, y, size], k) => {
    const at = toScreen([x, y], view, width, height);
    place(context, at[0], at[1], (size * view.scale) / 2, k + 1, view.ratio, look.colours.selected);
  });
  if (look.selected >= 0) ring(context, screen, corners, look.selected, view.ratio, look.colours.selected);
  return seen;
}

function toScreen(points, view, width, height) {
  const screen = new Float64Array(points.length);
  for (let i = 0; i < points.length; i += 2) {
    screen[i] = (points[i] - view.x) * view.scale + width / 2;
    screen[i + 1] = height / 2 - (points[i + 1] - view.y) * view.scale;
  }
  return screen;
}

// A side from where the path is to a vertex v, curved if its edge is.
function sideTo(context, screen, { stage, controls }, u, v) {
  const at = stage.bendOf.size ? bendAt(stage, u, v) : -1;
  if (at < 0) context.lineTo(screen[2 * v], screen[2 * v + 1]);
  else context.quadraticCurveTo(controls[at], controls[at + 1], screen[2 * v], screen[2 * v + 1]);
}

// Triangles at curved edges: what straight sides have left or covered is painted over.
function fillCurved(context, screen, bends, look) {
  const { corners, codes, bent } = bends.stage, edges = bends.stage.bends;
  const css = (p) => `rgb(${p & 255},${(p >> 8) & 255},${(p >> 16) & 255})`;
  context.fillStyle = look.colours.canvas;
  for (let i = 0; i < edges.length; i += 2) {
    context.beginPath();
    context.moveTo(screen[2 * edges[i]], screen[2 * edges[i] + 1]);
    sideTo(context, screen, bends, edges[i], edges[i + 1]);
    context.fill();
  }
  for (const t of bent) {
    context.fillStyle = isInverted(bends.stage, t) ? look.colours.inverted : css(look.shade(codes[t]));
    context.beginPath();
    context.moveTo(screen[2 * corners[3 * t]], screen[2 * corners[3 * t] + 1]);
    for (let k = 0; k < 3; k++) sideTo(context, screen, bends, corners[3 * t + k], corners[3 * t + ((k + 1) % 3)]);
    context.fill();
  }
}

function strokeEdges(context, screen, edges, colour, thickness, bends) {
  const { width, height } = context.canvas;
  context.strokeStyle = colour;
  context.lineWidth = thickness;
  context.beginPath();
  for (let i = 0; i < edges.length; i += 2) {
    const u = 2 * edges[i], v = 2 * edges[i + 1];
    const ux = screen[u], uy = screen[u + 1], vx = screen[v], vy = screen[v + 1];
    if ((ux < 0 && vx < 0) || (uy < 0 && vy < 0) || (ux > width && vx > width) || (uy > height && vy > height)) continue;
    context.moveTo(ux, uy);
    sideTo(context, screen, bends, edges[i], edges[i + 1]);
  }
  context.stroke();
}

function strokeTriangles(context, screen, corners, rows, colour, thickness) {
  context.strokeStyle = colour;
  context.lineWidth = thickness;
  context.lineJoin = "round";
  context.beginPath();
  for (const t of rows) {
    const [ax, ay, bx, by, cx, cy] = cornersOf({ points: screen, corners }, t);
    context.moveTo(ax, ay);
    context.lineTo(bx, by);
    context.lineTo(cx, cy);
    context.closePath();
  }
  context.stroke();
}

// The selected triangle: an outline between white ones, and a circle that finds it where it is tiny.
function ring(context, screen, corners, t, ratio, colour) {
  strokeTriangles(context, screen, corners, [t], "#fff", 6 * ratio);
  strokeTriangles(context, screen, corners, [t], colour, 3 * ratio);
  const [ax, ay, bx, by, cx, cy] = cornersOf({ points: screen, corners }, t);
  const x = (ax + bx + cx) / 3, y = (ay + by + cy) / 3;
  if (Math.max(Math.abs(ax - x), Math.abs(ay - y), Math.abs(bx - x), Math.abs(by - y)) > 20 * ratio) return;
  context.lineWidth = 2 * ratio;
  context.beginPath();
  context.arc(x, y, 24 * ratio, 0, 2 * Math.PI);
  context.stroke();
}

// A place where something is left: a red ring with its number, wide enough to be found and round what is there.
function place(context, x, y, half, number, ratio, colour) {
  const radius = Math.max(13 * ratio, half + 6 * ratio);
  for (const [thickness, shade] of [[5, "#fff"], [2.5, colour]]) {
    context.strokeStyle = shade;
    context.lineWidth = thickness * ratio;
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.stroke();
  }
  context.font = `bold ${13 * ratio}px system-ui, sans-serif`;
  context.textAlign = "center";
  context.lineWidth = 4 * ratio;
  context.strokeStyle = "#fff";
  const above = y - radius - 5 * ratio > 14 * ratio ? y - radius - 5 * ratio : y + radius + 15 * ratio;
  context.strokeText(number, x, above);
  context.fillStyle = colour;
  context.fillText(number, x, above);
}
