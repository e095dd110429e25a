// The page's controls: what the reader does, and what is then shown.  page_mesh.js paints.
//
// While one drags or zooms, a large mesh is painted without its edges; they follow when it rests.
"use strict";
(async () => {
  const at = (id) => document.getElementById(id);
  const header = JSON.parse(at("header").textContent);
  const shade = colourScale(header);
  const root = document.documentElement;
  // A mesh of more triangles is painted without edges while in motion.
  const LIGHT = 20000;

  const inTheDark = matchMedia("(prefers-color-scheme: dark)");
  const colours = () => (inTheDark.matches ? { ...header.colours, ...header.colours.dark } : header.colours);
  // Places in steps of the grid; they are those of the last stage.
  const marks = header.places.map(([x, y, size]) => [
    (x - header.origin[0]) / header.step, (y - header.origin[1]) / header.step, size / header.step,
  ]);

  function trouble(text) {
    at("trouble").hidden = false;
    at("trouble").textContent = text;
    root.dataset.state = "failed";
  }

  const view = { x: 0, y: 0, scale: 1, ratio: 1 };
  const state = { stage: 0, beside: false, selected: -1, fromBefore: false, worst: -1, moving: false, frame: 0, timer: 0, rest: 0 };
  let stages = [];
  let extent = null;

  function fit() {
    const canvas = at("canvas");
    view.x = (extent.x0 + extent.x1) / 2;
    view.y = (extent.y0 + extent.y1) / 2;
    const margin = 0.04 * extent.size;
    view.scale = Math.min(canvas.width / (extent.x1 - extent.x0 + margin), canvas.height / (extent.y1 - extent.y0 + margin));
    repaint();
  }

  function zoom(factor, px = at("canvas").width / 2, py = at("canvas").height / 2) {
    const canvas = at("canvas");
    const scale = Math.min(Math.max(view.scale * factor, (0.1 * canvas.width) / extent.size), (1e7 * canvas.width) / extent.size);
    const dx = px - canvas.width / 2, dy = canvas.height / 2 - py;
    view.x += dx / view.scale - dx / scale;
    view.y += dy / view.scale - dy / scale;
    view.scale = scale;
    moved();
  }

  function pan(dx, dy) {
    view.x -= dx / view.scale;
    view.y += dy / view.scale;
    moved();
  }

  function goTo(t) {
    const [ax, ay, bx, by, cx, cy] = cornersOf(current(), t);
    const x0 = Math.min(ax, bx, cx), x1 = Math.max(ax, bx, cx), y0 = Math.min(ay, by, cy), y1 = Math.max(ay, by, cy);
    view.x = (x0 + x1) / 2;
    view.y = (y0 + y1) / 2;
    const size = Math.max(x1 - x0, y1 - y0) || 1e-6 * extent.size;
    const canvas = at("canvas");
    view.scale = Math.min((0.15 * Math.min(canvas.width, canvas.height)) / size, (1e7 * canvas.width) / extent.size);
    select(t);
  }

  function goToPlace(k) {
    if (state.stage !== stages.length - 1) setStage(stages.length - 1);
    const canvas = at("canvas"), [x, y, size] = marks[k];
    view.x = x;
    view.y = y;
    view.scale = (0.2 * Math.min(canvas.width, canvas.height)) / Math.max(size, 0.02 * extent.size);
    canvas.scrollIntoView({ block: "nearest" });
    moved();
  }

  const current = () => prepare(stages[state.stage]);
  const before = () => prepare(stages[0]);
  // The stage that the selected triangle was picked in: a row may stand for other vertices after flips.
  const described = () => (state.fromBefore ? before() : current());

  function showsSelected(stage) {
    const t = state.selected, chosen = described();
    if (t < 0 || t >= stage.count || t >= chosen.count) return false;
    return stage === chosen || [0, 1, 2].every((k) => stage.corners[3 * t + k] === chosen.corners[3 * t + k]);
  }

  const canvases = () => (state.beside ? [at("canvas-before"), at("canvas")] : [at("canvas")]);

  function repaint() {
    if (!state.frame) state.frame = requestAnimationFrame(paintAll);
  }

  // Something is in motion: paint at once, without edges where they would cost too much; with them when it rests.
  function moved() {
    state.moving = true;
    clearTimeout(state.rest);
    state.rest = setTimeout(() => { state.moving = false; repaint(); }, 150);
    repaint();
  }

  function paintAll() {
    state.frame = 0;
    view.ratio = devicePixelRatio;
    const started = performance.now();
    for (const canvas of canvases()) {
      const stage = canvas.id === "canvas" ? current() : before();
      root.dataset.seen = paint(canvas, stage, view, {
        shade,
        colours: colours(),
        places: stage === stages[stages.length - 1] ? marks : [],
        edges: !state.moving || stage.count <= LIGHT,
        selected: showsSelected(stage) ? state.selected : -1,
      });
    }
    root.dataset.frame = (performance.now() - started).toFixed(1);
    root.dataset.moving = state.moving;
    root.dataset.view = [view.x, view.y, view.scale].join(" ");
  }

  function resize() {
    // As high as the mesh needs, between what a finger can use and what leaves the controls in sight.
    const aspect = Math.max(extent.y1 - extent.y0, 0.1 * extent.size) / Math.max(extent.x1 - extent.x0, 0.1 * extent.size);
    for (const canvas of canvases()) {
      const wanted = 1.06 * aspect * canvas.parentElement.clientWidth;
      canvas.style.height = `${Math.max(260, Math.min(wanted, 0.68 * innerHeight))}px`;
      const box = canvas.getBoundingClientRect();
      canvas.width = Math.max(1, Math.round((box.width - 2) * devicePixelRatio));
      canvas.height = Math.max(1, Math.round((box.height - 2) * devicePixelRatio));
    }
  }

  // --- what the reader does -----------------------------------------------------------------------

  function setStage(index) {
    state.stage = Math.min(Math.max(index, 0), stages.length - 1);
    state.worst = -1;
    const stage = current();
    at("stage").value = state.stage;
    at("stage-name").textContent = stage.label;
    at("stage").setAttribute("aria-valuetext", stage.label);
    at("caption").textContent = stage.name;
    at("row").max = stage.count - 1;
    for (const row of document.querySelectorAll("tr[data-stage]")) {
      row.setAttribute("aria-current", String(Number(row.dataset.stage) === state.stage));
    }
    if (state.selected >= described().count) state.selected = -1;
    describe();
    repaint();
  }

  function setBeside(on) {
    state.beside = on;
    at("pane-before").hidden = !on;
    at("beside").setAttribute("aria-pressed", String(on));
    const share = view.scale / at("canvas").width;
    resize();
    view.scale = share * at("canvas").width;
    repaint();
  }

  function play(on) {
    clearInterval(state.timer);
    state.timer = on ? setInterval(() => (state.stage + 1 < stages.length ? setStage(state.stage + 1) : play(false)), 700) : 0;
    at("play").setAttribute("aria-pressed", String(on));
    at("play").textContent = on ? "Stop" : "Play";
    if (on && state.stage === stages.length - 1) setStage(0);
  }

  function nextWorst(step) {
    const stage = current();
    state.worst = (state.worst + step + stage.worst.length) % stage.worst.length;
    if (state.worst < 0) state.worst = 0;
    goTo(stage.worst[state.worst]);
  }

  function select(t, fromBefore = false) {
    state.selected = t;
    state.fromBefore = fromBefore;
    if (t >= 0) at("row").value = t;
    describe();
    repaint();
  }

  // The triangle at a position on a canvas, or -1.
  function pick(canvas, px, py) {
    const stage = canvas.id === "canvas" ? current() : before();
    return triangleAt(stage, view.x + (px - canvas.width / 2) / view.scale, view.y + (canvas.height / 2 - py) / view.scale);
  }

  // In space, in the file's own coordinates; two numbers for a mesh in a plane z = 0.
  function position(points, v) {
    const [o, e, f] = header.frame;
    const x = header.origin[0] + header.step * points[2 * v], y = header.origin[1] + header.step * points[2 * v + 1];
    const xyz = [0, 1, 2].map((k) => o[k] + x * e[k] + y * f[k]);
    const flat = o[2] === 0 && e[2] === 0 && f[2] === 0;
    return `(${(flat ? xyz.slice(0, 2) : xyz).map((v) => Number(v.toPrecision(7))).join(", ")})`;
  }

  function ratioText(stage, t) {
    const code = stage.codes[t], value = 2 ** (code / header.codesADoubling);
    return code === header.infiniteCode ? "infinite" : code === header.infiniteCode - 1 ? `over ${value.toPrecision(2)}` : value.toPrecision(4);
  }

  // The triangle under the pointer, beside it: its row and quality.
  function tell(canvas, event, spot) {
    const tip = at("tip"), { x, y } = spot(event);
    const t = pick(canvas, x, y);
    tip.hidden = t < 0;
    if (t < 0) return;
    const stage = canvas.id === "canvas" ? current() : before();
    tip.textContent = `triangle ${t}${isInverted(stage, t) ? ", inverted" : ""}, IMR ${ratioText(stage, t)}`;
    const room = document.documentElement.clientWidth - tip.offsetWidth - 4;
    tip.style.left = `${scrollX + Math.max(4, Math.min(event.clientX + 14, room))}px`;
    tip.style.top = `${scrollY + event.clientY + 18}px`;
  }

  function describe() {
    const box = at("details"), t = state.selected;
    if (t < 0) {
      box.className = "";
      box.textContent = "Click a triangle for its row and shape.";
      return;
    }
    const stage = described(), shape = cornersOf(stage, t), bad = isInverted(stage, t), ratio = ratioText(stage, t);
    const vertices = [0, 1, 2].map((k) => stage.corners[3 * t + k]).map((v) => `${v} ${position(stage.points, v)}`);
    box.className = bad ? "bad" : "";
    box.textContent =
      `Triangle ${t}${bad ? ", inverted" : ""} (stage ${stage.name}): inverse mean ratio ${ratio}, ` +
      `smallest angle ${smallestAngle(shape).toFixed(1)}°, area ${(signedArea(shape) * header.step ** 2).toPrecision(3)}; ` +
      `vertices ${vertices.join(", ")}`;
  }

  function listen() {
    at("stage").addEventListener("input", () => setStage(Number(at("stage").value)));
    at("previous").addEventListener("click", () => setStage(state.stage - 1));
    at("next").addEventListener("click", () => setStage(state.stage + 1));
    at("play").addEventListener("click", () => play(!state.timer));
    at("in").addEventListener("click", () => zoom(1.5));
    at("out").addEventListener("click", () => zoom(1 / 1.5));
    at("fit").addEventListener("click", fit);
    at("worst").addEventListener("click", () => nextWorst(1));
    at("beside").addEventListener("click", () => setBeside(!state.beside));
    at("goto").addEventListener("submit", (event) => {
      event.preventDefault();
      const t = Number(at("row").value);
      if (Number.isInteger(t) && t >= 0 && t < current().count) goTo(t);
    });
    for (const button of document.querySelectorAll("button[data-stage]")) {
      button.addEventListener("click", () => {
        setStage(Number(button.dataset.stage));
        at("canvas").scrollIntoView({ block: "center" });
      });
    }
    for (const button of document.querySelectorAll("button[data-place]")) {
      button.addEventListener("click", () => goToPlace(Number(button.dataset.place)));
    }
    inTheDark.addEventListener("change", repaint);
    for (const canvas of [at("canvas"), at("canvas-before")]) {
      canvas.addEventListener("keydown", keys);
      listenToPointers(canvas);
    }
    new ResizeObserver(() => {
      const share = view.scale / at("canvas").width;
      resize();
      view.scale = share * at("canvas").width;
      repaint();
    }).observe(at("panes"));
  }

  function keys(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = 0.1 * at("canvas").width;
    const middle = () => select(pick(at("canvas"), at("canvas").width / 2, at("canvas").height / 2));
    const actions = {
      ArrowLeft: () => pan(step, 0), ArrowRight: () => pan(-step, 0), ArrowUp: () => pan(0, step), ArrowDown: () => pan(0, -step),
      "+": () => zoom(1.5), "=": () => zoom(1.5), "-": () => zoom(1 / 1.5), 0: fit,
      ",": () => setStage(state.stage - 1), ".": () => setStage(state.stage + 1),
      n: () => nextWorst(1), p: () => nextWorst(-1), Enter: middle, Escape: () => select(-1),
    };
    const action = actions[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  }

  function listenToPointers(canvas) {
    const down = new Map();
    let travelled = 0, pinched = false, start = 0, waiting = null;
    const hover = (event) => {
      if (!waiting) requestAnimationFrame(() => { tell(canvas, waiting, spot); waiting = null; });
      waiting = event;
    };
    const spot = (event) => {
      const box = canvas.getBoundingClientRect();
      return { x: (event.clientX - box.left - 1) * devicePixelRatio, y: (event.clientY - box.top - 1) * devicePixelRatio };
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      canvas.setPointerCapture(event.pointerId);
      if (!down.size) { travelled = 0; pinched = false; start = 0; }
      down.set(event.pointerId, spot(event));
    });
    canvas.addEventListener("pointermove", (event) => {
      const old = down.get(event.pointerId);
      if (!old) {
        if (event.pointerType !== "touch") hover(event);
        return;
      }
      at("tip").hidden = true;
      const now = spot(event);
      const others = [...down].filter(([id]) => id !== event.pointerId).map(([, p]) => p);
      travelled += Math.hypot(now.x - old.x, now.y - old.y) + (others.length ? 100 : 0);
      if (others.length) {
        const [other] = others;
        const apart = Math.hypot(now.x - other.x, now.y - other.y);
        start = start || Math.hypot(old.x - other.x, old.y - other.y);
        pinched = pinched || Math.abs(apart - start) > 24 * devicePixelRatio;
        if (pinched) {
          const before = Math.hypot(old.x - other.x, old.y - other.y);
          pan((now.x - old.x) / 2, (now.y - old.y) / 2);
          if (before > 0) zoom(apart / before, (now.x + other.x) / 2, (now.y + other.y) / 2);
        } else if (down.size === 2) {
          // Two fingers that go side by side scroll the page past the picture.  Each reports half of the way.
          scrollBy(0, (old.y - now.y) / 2 / devicePixelRatio);
        }
      } else if (travelled > 5 * devicePixelRatio) {
        pan(now.x - old.x, now.y - old.y);
      }
      down.set(event.pointerId, now);
    });
    canvas.addEventListener("pointerleave", () => { at("tip").hidden = true; });
    canvas.addEventListener("pointerup", (event) => {
      const { x, y } = spot(event);
      if (down.delete(event.pointerId) && !down.size && travelled <= 5 * devicePixelRatio) {
        select(pick(canvas, x, y), canvas.id === "canvas-before");
      }
    });
    canvas.addEventListener("pointercancel", (event) => down.delete(event.pointerId));
    // A wheel, and two fingers on a trackpad, scroll the page; with Ctrl, and by pinching, they zoom.
    canvas.addEventListener("wheel", (event) => {
      at("tip").hidden = true;
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      const { x, y } = spot(event);
      zoom(Math.exp(-event.deltaY * (event.deltaMode === 1 ? 0.05 : event.ctrlKey && Math.abs(event.deltaY) < 50 ? 0.01 : 0.0015)), x, y);
    }, { passive: false });
  }

  if (typeof DecompressionStream === "undefined") {
    trouble("This browser is too old to show the mesh (it has no DecompressionStream); tables and histograms are complete.");
    return;
  }
  stages = unpack(header, await inflate(at("data").textContent.trim()));
  extent = extentOf(stages);
  at("stage").max = stages.length - 1;
  state.beside = innerWidth >= 900;
  at("pane-before").hidden = !state.beside;
  at("beside").setAttribute("aria-pressed", String(state.beside));
  resize();
  listen();
  setStage(stages.length - 1);
  fit();
  root.dataset.state = "ready";
})();
