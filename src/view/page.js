// The page: state, controls, frames.
(() => {
  const by = (id) => document.getElementById(id);
  const data = JSON.parse(by("data").textContent);
  const canvas = by("view");
  const say = (result) => {
    by("result").textContent = JSON.stringify(result);
    by("result").hidden = false;
  };
  const fail = (error) => {
    by("message").textContent = error.message;
    for (const id of ["panel", "status", "scale"]) by(id).hidden = true;
    document.documentElement.dataset.state = "failed";
    if (asked.has("selftest") || asked.has("render")) say({ right: false, problem: error.message });
  };
  const clamp = (v, low, high) => Math.min(Math.max(v, low), high);
  const asked = new URLSearchParams(location.hash.slice(1));
  const choice = (name, options, otherwise) => (options.includes(asked.get(name)) ? asked.get(name) : otherwise);
  const number = (name, otherwise) => {
    const value = asked.has(name) ? Number(asked.get(name)) : NaN;
    return Number.isFinite(value) ? value : otherwise;
  };
  const list = (name, lengths) => {
    const values = asked.has(name) ? asked.get(name).split(",").map(Number) : [];
    return lengths.includes(values.length) && values.every(Number.isFinite) ? values : null;
  };
  // Pictures for docs: so many frames at full size before the page counts as loaded, and none after.
  const still = clamp(number("still", 0), 0, 512);
  const bare = asked.get("bare") === "1";

  // Tiles along u for one along v, so that a tile is about as wide as high.
  const ASPECT = { plane: 1, sphere: 2, torus: 2, cloth: 1 };
  const START = {
    plane: { azimuth: -90, elevation: 46, distance: 4.6 },
    sphere: { azimuth: -68, elevation: 20, distance: 4.4 },
    torus: { azimuth: -72, elevation: 40, distance: 4.5 },
    cloth: { azimuth: -62, elevation: 30, distance: 4.1 },
  };
  const FOV = 32;
  const LIGHT = [-0.25, -0.72, 0.65];
  const MOST_FRAMES = { one: 24, sky: 192 };
  // Milliseconds of a frame: a moving one is made coarser above the first and finer below the second, a still one likewise.
  const MOVING = { most: 45, least: 15, coarsest: 0.2 };
  const STILL = { most: 700, least: 250, coarsest: 0.4 };

  function fresh(shape) {
    return {
      shape,
      ...START[shape],
      tiling: 2,
      tiles: null,
      light: unit(LIGHT),
      lights: "one",
      drag: "camera",
      bias: 0,
      exposure: 0,
      mode: "exact",
      show: "material",
      largest: -2,
    };
  }
  const state = fresh(choice("shape", SHAPES, "sphere"));
  function fromAddress() {
    const tiling = list("tiling", [1, 2]);
    if (tiling && tiling.length === 1) state.tiling = clamp(Math.log2(Math.max(tiling[0], 1)), 0, 5);
    if (tiling && tiling.length === 2) state.tiles = tiling;
    state.light = unit(list("light", [3]) ?? state.light);
    state.lights = choice("lights", ["one", "sky"], state.lights);
    state.mode = choice("mode", Object.keys(data.shader.modes), state.mode);
    state.show = choice("show", data.reference ? ["material", "levels", "error"] : ["material", "levels"], state.show);
    state.bias = clamp(number("level", 0), -3, 5);
    state.exposure = clamp(number("exposure", 0), -5, 5);
    state.largest = clamp(Math.log2(number("largest", 2 ** state.largest)), -8, 2);
    for (const name of ["azimuth", "elevation", "distance"]) state[name] = number(name, state[name]);
  }

  let engine;
  let reference = null;
  let numbers;

  // Frames: a coarse one while something moves, then finer ones whose mean is shown.
  const pace = { moving: 0.6, still: 1, frames: 0, moved: 0, fence: null, started: 0, pixels: 0, ms: 0, last: 0, fps: 0, due: false, size: "" };
  const moving = () => performance.now() - pace.moved < 160;
  function changed(still = false) {
    pace.frames = 0;
    if (!still) pace.moved = performance.now();
    wake();
  }
  function wake() {
    if (!pace.due && engine && !still) {
      pace.due = true;
      requestAnimationFrame(frame);
    }
  }

  const toView = (a, e) => [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
  const radians = (degrees) => (degrees * Math.PI) / 180;
  function camera(width, height) {
    const out = toView(radians(state.azimuth), radians(state.elevation));
    // The field of view is that of the shorter side.
    const half = Math.tan(radians(FOV) / 2) * Math.max(1, width / height);
    // The panel covers a part of a wide window: the shape stands in the middle of the rest.
    const aside = scaled(seen()[0], (state.distance * half * covered()) / innerWidth);
    const origin = add(scaled(out, state.distance), aside);
    return { origin, target: aside, up: [0, 0, 1], fov: (2 * Math.atan(half) * 180) / Math.PI };
  }
  const covered = () => (innerWidth > 600 && !bare && !by("panel").classList.contains("folded") ? 284 : 0);
  const tiles = () => state.tiles ?? [Math.round(2 ** state.tiling) * ASPECT[state.shape], Math.round(2 ** state.tiling)];
  function scene(index, width, height) {
    return {
      shape: state.shape,
      tiling: tiles(),
      camera: camera(width, height),
      lights: lightsOf(state.lights, state.light, index),
      bias: state.bias,
      mode: state.mode,
      view: state.show === "levels" ? VIEWS.levels : VIEWS.material,
      jitter: index === 0 ? [0, 0] : [halton(index, 2) - 0.5, halton(index, 3) - 0.5],
    };
  }

  function fit() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2.5);
    const [width, height] = [innerWidth, innerHeight].map((v) => Math.max(1, Math.round(v * ratio)));
    if (canvas.width === width && canvas.height === height) return;
    canvas.width = width;
    canvas.height = height;
    changed(true);
  }
  function size() {
    const scale = still ? 1 : moving() ? pace.moving : Math.max(pace.moving, pace.still);
    return [canvas.width, canvas.height].map((v) => Math.max(1, Math.round(v * scale)));
  }

  function drawFrame(wait = false) {
    const [width, height] = size();
    const target = engine.target("frame", width, height, { depth: true });
    const key = `${width} ${height}`;
    if (pace.size !== key) pace.frames = 0;
    pace.size = key;
    pace.kind = moving() ? "moving" : "still";
    if (!engine.draw(target, scene(pace.frames, width, height), wait)) return false;
    const mean = engine.blend(target, pace.frames);
    pace.frames += 1;
    pace.pixels = width * height;
    const levels = state.show === "levels";
    engine.present(mean, levels ? VIEWS.levels : VIEWS.material, {
      exposure: 2 ** state.exposure,
      largest: Math.max(data.coarsest, 1),
    });
    return true;
  }

  // The resolution follows what the last frame took.
  function adapt() {
    const { most, least, coarsest } = pace.kind === "moving" ? MOVING : STILL;
    const scale = pace[pace.kind];
    if (pace.ms > most) pace[pace.kind] = Math.max(coarsest, scale * Math.max(0.6, 0.95 * Math.sqrt(most / pace.ms)));
    else if (pace.ms < least) pace[pace.kind] = Math.min(1, scale * (pace.kind === "moving" ? 1.1 : 1.5));
  }
  function frame() {
    pace.due = false;
    if (engine.gl.isContextLost()) return;
    try {
      step();
    } catch (error) {
      fail(error);
    }
  }
  function step() {
    const { gl } = engine;
    fit();
    if (pace.fence) {
      const status = gl.clientWaitSync(pace.fence, 0, 0);
      if (status === gl.TIMEOUT_EXPIRED) return wake();
      gl.deleteSync(pace.fence);
      pace.fence = null;
      pace.ms = performance.now() - pace.started;
      // The first frame of a mode and shape includes what the driver still compiles.
      const kind = state.mode + state.shape;
      if (pace.warm === kind) adapt();
      pace.warm = kind;
      report();
    }
    if (state.show === "error") return compare();
    // Frames of a moving scene are not averaged.
    if (moving() || pace.size !== size().join(" ")) pace.frames = 0;
    if (pace.frames >= MOST_FRAMES[state.lights]) return;
    pace.started = performance.now();
    pace.fps = 0.8 * pace.fps + 0.2 * (1000 / Math.max(1, pace.started - pace.last));
    pace.last = pace.started;
    if (drawFrame()) {
      by("message").textContent = "";
      document.documentElement.dataset.state = "drawn";
      pace.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
      gl.flush();
    } else {
      by("message").textContent = "Compiling the shader\u2026";
    }
    wake();
  }

  const grouped = (v) => Math.round(v).toString().replace(/\B(?=(\d{3})+$)/g, "\u202f");
  function report() {
    const texts = [];
    if (moving()) texts.push(`${pace.fps.toFixed(pace.fps < 10 ? 1 : 0)} frames/s`);
    if (pace.ms) texts.push(`${pace.ms.toFixed(pace.ms < 10 ? 1 : 0)} ms a frame`);
    if (pace.ms) texts.push(`${Math.round(Math.sqrt(pace.pixels / canvas.width / canvas.height) * 100)} % resolution`);
    if (state.lights === "sky" && state.show === "material") texts.push(`${grouped(pace.frames * SKY_LIGHTS)} lights`);
    texts.push(`${grouped(data.flops)} operations a query`);
    by("status").textContent = texts.join("  \u00b7  ");
  }

  // The reference frame: its queries answered, beside it, with what they are apart.
  function loadReference() {
    if (!data.reference) return;
    const { width, height } = data.reference;
    const part = (name) => floats(numbers, data.numbers.reference[name]);
    const queries = { u: part("u"), wi: part("wi"), wo: part("wo"), level: part("level") };
    const rgb = part("rgb");
    const four = new Float32Array(4 * width * height).fill(1);
    for (let i = 0; i < width * height; i++) four.set(rgb.subarray(3 * i, 3 * i + 3), 4 * i);
    const picture = { texture: engine.values(width, height, four), width, height };
    reference = { width, height, rgb, picture, asked: engine.ask(queries, width), drawn: "" };
  }
  const PANELS = ["Reference", "Answer", "Difference"];
  function compare(wait = false) {
    const { width, height } = reference;
    const target = engine.target("reference", width, height);
    if (reference.drawn !== state.mode) {
      if (!engine.draw(target, { queries: reference.asked.textures, mode: state.mode }, wait)) {
        by("message").textContent = "Compiling the shader\u2026";
        return wake();
      }
      reference.drawn = state.mode;
      reference.errors = errors(engine.read(target), reference.rgb);
    }
    by("message").textContent = "";
    const { gl } = engine;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.clearColor(0.085, 0.088, 0.095, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const ratio = canvas.width / innerWidth;
    const [wide, high] = [innerWidth - covered() - 32, innerHeight - 90];
    const gap = 12;
    const beside = Math.min((wide - 2 * gap) / (3 * width), high / height);
    const below = Math.min(wide / width, (high - 20 - 2 * (gap + 18)) / (3 * height));
    const across = beside >= below;
    const scale = Math.max(beside, below, 1e-3);
    const [w, h] = [width * scale, height * scale].map((v) => Math.max(1, Math.floor(v)));
    const captions = PANELS.map((text, k) => {
      const left = across ? 16 + (wide - 3 * w - 2 * gap) / 2 + k * (w + gap) : 16 + (wide - w) / 2;
      const top = across ? 36 + (high - h) / 2 : 84 + k * (h + gap + 18);
      const rectangle = [left, innerHeight - top - h, w, h].map((v) => Math.round(v * ratio));
      const largest = 2 ** state.largest;
      const picture = k === 0 ? reference.picture : target;
      const exposure = 2 ** state.exposure;
      engine.present(picture, k === 2 ? VIEWS.error : VIEWS.answer, { rectangle, exposure, largest, reference: reference.picture });
      const span = document.createElement("span");
      span.style.left = `${left}px`;
      span.style.top = `${top - 20}px`;
      span.textContent = text;
      return span;
    });
    by("captions").replaceChildren(...captions);
    const { mse, mean, largest } = reference.errors;
    by("errors").textContent = `mse ${(1e3 * mse).toPrecision(3)} \u00d7 10\u207b\u00b3 (clamped), mean |difference| ${mean.toPrecision(3)}, largest ${largest.toPrecision(3)}`;
    by("status").textContent = `${data.reference.name}  \u00b7  ${width} \u00d7 ${height} queries`;
    document.documentElement.dataset.state = "drawn";
  }
  function errors(answers, expected) {
    const bounded = (v) => clamp(v, 0, 1);
    let [mse, mean, largest] = [0, 0, 0];
    expected.forEach((value, i) => {
      const apart = Math.abs(answers[i] - value);
      mse += (bounded(answers[i]) - bounded(value)) ** 2;
      mean += apart;
      largest = Math.max(largest, apart);
    });
    return { mse: mse / expected.length, mean: mean / expected.length, largest };
  }

  // Controls.
  const CHOICES = {
    shape: [["plane", "Plane"], ["sphere", "Sphere"], ["torus", "Torus"], ["cloth", "Cloth"]],
    lights: [["one", "Distant"], ["sky", "Sky"]],
    drag: [["camera", "View"], ["light", "Light"]],
    mode: [["exact", "Exact"], ["fast", "Fast"]].filter(([mode]) => mode in data.shader.modes),
    show: [["material", "Shaded"], ["levels", "Level"]].concat(data.reference ? [["error", "Error"]] : []),
  };
  const SLIDERS = { tiling: "tiling", level: "bias", exposure: "exposure", largest: "largest" };
  function build() {
    for (const [name, options] of Object.entries(CHOICES)) {
      for (const [value, text] of options) {
        const label = document.createElement("label");
        const input = Object.assign(document.createElement("input"), { type: "radio", name, value });
        const span = Object.assign(document.createElement("span"), { textContent: text });
        input.addEventListener("change", () => set(name, value));
        label.append(input, span);
        by(name).append(label);
      }
    }
    for (const [id, name] of Object.entries(SLIDERS)) {
      by(id).addEventListener("input", (event) => {
        state[name] = Number(event.target.value);
        if (name === "tiling") state.tiles = null;
        sync();
        changed();
      });
    }
    const [height, width] = data.resolution;
    by("facts").textContent = `${width} \u00d7 ${height} texels, ${data.levels} levels, ${(data.bytes / 1e6).toPrecision(2)} MB; ${grouped(data.flops)} operations a query`;
    by("fold").addEventListener("click", fold);
    by("reset").addEventListener("click", reset);
    by("save").addEventListener("click", save);
    by("help").addEventListener("click", help);
    by("panel").addEventListener("submit", (event) => event.preventDefault());
    by("keys").querySelector("dl").append(
      ...KEYS.flatMap(([keys, text]) => [["dt", keys], ["dd", text]]).map(([name, text]) =>
        Object.assign(document.createElement(name), { textContent: text }),
      ),
    );
  }
  function set(name, value) {
    state[name] = value;
    if (name === "shape") Object.assign(state, START[value], { tiles: null });
    if (name === "shape" && state.show === "error") state.show = "material";
    sync();
    changed(name !== "shape");
  }
  function sync() {
    for (const name of Object.keys(CHOICES)) {
      for (const input of by(name).querySelectorAll("input")) input.checked = input.value === state[name];
    }
    for (const [id, name] of Object.entries(SLIDERS)) by(id).value = state[name];
    const signed = (v) => `${v > 0 ? "+" : v < 0 ? "\u2212" : ""}${Math.abs(v).toFixed(1)}`;
    by("tiling-value").value = tiles().join(" \u00d7 ");
    by("level-value").value = signed(state.bias);
    by("exposure-value").value = `${signed(state.exposure)} EV`;
    by("largest-value").value = (2 ** state.largest).toPrecision(2);
    const error = state.show === "error";
    by("error-range").hidden = by("errors").hidden = !error;
    by("scale").hidden = state.show === "material";
    by("captions").hidden = !error;
    const [from, to] = by("scale").querySelectorAll("span");
    from.textContent = error ? "0" : "level 0";
    to.textContent = error ? (2 ** state.largest).toPrecision(2) : data.coarsest;
    canvas.classList.toggle("light", state.drag === "light");
    pad();
  }
  function scale() {
    const canvas = by("scale").querySelector("canvas");
    const context = canvas.getContext("2d");
    const stops = ["#05050f", "#33126b", "#87217a", "#db4757", "#fa9940", "#fff5b3"];
    const gradient = context.createLinearGradient(0, 0, canvas.width, 0);
    stops.forEach((colour, k) => gradient.addColorStop(k / (stops.length - 1), colour));
    context.fillStyle = gradient;
    context.fillRect(0, 0, canvas.width, canvas.height);
  }
  function fold() {
    const folded = by("panel").classList.toggle("folded");
    by("fold").setAttribute("aria-expanded", String(!folded));
    changed(true);
  }
  function reset() {
    const { shape, mode } = state;
    Object.assign(state, fresh(shape), { mode });
    sync();
    changed();
  }
  function save() {
    canvas.toBlob((blob) => {
      const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: `${data.name}.png` });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    });
  }
  const help = () => by("keys").showModal();

  // The light as seen by the viewer: right, up, towards.
  function seen() {
    const out = toView(radians(state.azimuth), radians(state.elevation));
    const right = unit(cross([0, 0, 1], out));
    return [right, cross(out, right), out];
  }
  function pad() {
    const [x, y, z] = seen().map((axis) => dot(axis, state.light));
    const pad = by("pad");
    pad.style.setProperty("--x", `${50 + 46 * x}%`);
    pad.style.setProperty("--y", `${50 - 46 * y}%`);
    pad.classList.toggle("behind", z < 0);
    by("light-label").textContent = `Light ${Math.round((Math.asin(clamp(state.light[2], -1, 1)) * 180) / Math.PI)}\u00b0 up`;
  }
  function turn(dx, dy) {
    const lowest = state.shape === "plane" ? 2 : -88;
    state.azimuth = ((state.azimuth - dx + 540) % 360) - 180;
    state.elevation = clamp(state.elevation + dy, lowest, 88);
    pad();
    changed();
  }
  function turnLight(dx, dy) {
    const [right, up, out] = seen();
    const turned = add(add(state.light, right, radians(dx)), up, radians(dy));
    // Straight moves would stop at the rim: beyond it the light goes on around the shape.
    const z = dot(state.light, out);
    const inward = dot(state.light, right) * radians(dx) + dot(state.light, up) * radians(dy);
    state.light = unit(add(turned, out, Math.abs(z) < 0.12 ? -Math.sign(inward) * Math.abs(inward) : 0));
    pad();
    changed();
  }
  function zoom(factor) {
    state.distance = clamp(state.distance * factor, 1.15, 14);
    changed();
  }

  function pointers() {
    const down = new Map();
    let light = false;
    const spread = () => {
      const [a, b] = [...down.values()];
      return { apart: Math.hypot(a.x - b.x, a.y - b.y), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 };
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      down.set(event.pointerId, { x: event.clientX, y: event.clientY });
      light = event.button === 2 || event.shiftKey || state.drag === "light";
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = down.get(event.pointerId);
      if (!before) return;
      const old = down.size === 2 ? spread() : null;
      const [dx, dy] = [event.clientX - before.x, event.clientY - before.y];
      down.set(event.pointerId, { x: event.clientX, y: event.clientY });
      if (old) {
        const now = spread();
        zoom(old.apart / Math.max(now.apart, 1));
        turnLight((now.x - old.x) * 0.4, (old.y - now.y) * 0.4);
      } else if (down.size === 1) {
        if (light) turnLight(dx * 0.4, -dy * 0.4);
        else turn(dx * 0.4, dy * 0.4);
      }
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => down.delete(event.pointerId));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(Math.exp(clamp(event.deltaY, -120, 120) * 0.0012));
    }, { passive: false });
    const place = (event) => {
      const box = by("pad").getBoundingClientRect();
      let [x, y] = [(event.clientX - box.left) / box.width - 0.5, 0.5 - (event.clientY - box.top) / box.height].map((v) => v / 0.46);
      const r = Math.hypot(x, y);
      if (r > 0.999) [x, y] = [(0.999 * x) / r, (0.999 * y) / r];
      const [right, up, out] = seen();
      state.light = unit(add(add(scaled(right, x), up, y), out, Math.sqrt(1 - x * x - y * y)));
      pad();
      changed();
    };
    by("pad").addEventListener("pointerdown", (event) => {
      by("pad").setPointerCapture(event.pointerId);
      place(event);
    });
    by("pad").addEventListener("pointermove", (event) => event.buttons && place(event));
  }

  const KEYS = [
    ["drag, arrows", "turn the camera"],
    ["shift or right drag, W A S D", "move the light"],
    ["wheel, pinch, Z X", "come nearer or go away"],
    ["two fingers", "move the light"],
    ["1 2 3 4", "plane, sphere, torus, cloth"],
    ["[ ]", "finer or coarser level"],
    ["\u2212 =", "fewer or more tiles"],
    [", .", "darker or brighter"],
    ["L", "distant light or sky"],
    ["F", "exact or fast shader"],
    ["V", "shaded or false-coloured level"],
    ["E", "error against the reference frame"],
    ["H", "hide or show the controls"],
    ["R", "reset"],
    ["?", "this list"],
  ];
  function slide(id, delta) {
    const input = by(id);
    input.value = Number(input.value) + delta;
    input.dispatchEvent(new Event("input"));
  }
  const other = (name, pair) => set(name, state[name] === pair[0] ? pair[1] : pair[0]);
  const ACTIONS = {
    ArrowLeft: () => turn(-4, 0),
    ArrowRight: () => turn(4, 0),
    ArrowUp: () => turn(0, 4),
    ArrowDown: () => turn(0, -4),
    a: () => turnLight(-5, 0),
    d: () => turnLight(5, 0),
    w: () => turnLight(0, 5),
    s: () => turnLight(0, -5),
    z: () => zoom(0.92),
    x: () => zoom(1.08),
    "[": () => slide("level", -0.5),
    "]": () => slide("level", 0.5),
    "-": () => slide("tiling", -0.5),
    "=": () => slide("tiling", 0.5),
    "+": () => slide("tiling", 0.5),
    ",": () => slide("exposure", -0.5),
    ".": () => slide("exposure", 0.5),
    l: () => other("lights", ["one", "sky"]),
    f: () => CHOICES.mode.length > 1 && other("mode", ["exact", "fast"]),
    v: () => other("show", ["material", "levels"]),
    e: () => data.reference && other("show", ["material", "error"]),
    h: fold,
    r: reset,
    "?": help,
  };
  SHAPES.forEach((shape, k) => (ACTIONS[k + 1] = () => set("shape", shape)));
  function keys() {
    addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || by("keys").open) return;
      // Sliders and choices keep their own keys.
      const inside = event.target instanceof HTMLInputElement && event.key.startsWith("Arrow");
      const action = ACTIONS[event.key] ?? ACTIONS[event.key.toLowerCase()];
      if (inside || !action) return;
      event.preventDefault();
      action();
    });
  }

  function start() {
    numbers = unpacked(by("numbers").textContent);
    by("numbers").remove();
    engine = new Engine(canvas, data, numbers);
    loadReference();
    window.neumip = {
      data,
      // Linear RGB of a shape: rows from the top, f cos under lights of the given irradiance.
      render: ({ light = [0, 0, 1], irradiance = 1, tiling = 1, mode = "exact", bias = 0, ...rest }) =>
        engine.render({
          ...rest,
          mode,
          bias,
          tiling: [tiling].flat().length === 2 ? tiling : [tiling, tiling].flat(),
          lights: [{ direction: unit(light), irradiance: [irradiance, irradiance, irradiance].flat().slice(0, 3) }],
        }),
      // Answers to queries: u, wi, wo flat pairs, level flat.
      answer: (queries, mode = "exact") => engine.answer(queries, mode),
      // Milliseconds of a frame of 256 x 256 pixels, all of the plane.
      time: (mode = "exact") => timed(engine, mode),
      selftest: (times) => selftest(engine, data, numbers, times),
    };
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      pace.fence = null;
      by("message").textContent = "The graphics device was lost; waiting for it\u2026";
    });
    canvas.addEventListener("webglcontextrestored", () => {
      try {
        engine.restore();
        loadReference();
        changed(true);
      } catch (error) {
        fail(error);
      }
    });
    if (asked.has("selftest")) {
      const result = window.neumip.selftest(asked.get("selftest") === "times");
      document.title = result.right ? "right" : "wrong";
      return say(result);
    }
    if (asked.has("render")) {
      const { width, height, pixels } = window.neumip.render(JSON.parse(asked.get("render")));
      const bytes = new Uint8Array(pixels.buffer);
      let binary = "";
      for (let i = 0; i < bytes.length; i += 4096) binary += String.fromCharCode(...bytes.subarray(i, i + 4096));
      return say({ width, height, pixels: btoa(binary) });
    }
    if (asked.has("panel") ? asked.get("panel") === "0" : innerWidth <= 600) fold();
    if (bare) for (const id of ["panel", "status"]) by(id).style.display = "none";
    fit();
    if (still) drawStill();
    addEventListener("resize", still ? drawStill : () => changed(true));
    changed(true);
  }
  function drawStill() {
    fit();
    if (state.show === "error") return compare(true);
    pace.frames = 0;
    for (let k = 0; k < still; k++) {
      drawFrame(true);
      // Frame by frame: a queue of many looks like a device that hangs.
      engine.gl.readPixels(0, 0, 1, 1, engine.gl.RGBA, engine.gl.UNSIGNED_BYTE, new Uint8Array(4));
    }
    document.documentElement.dataset.state = "drawn";
    report();
  }

  try {
    if (!data) throw new Error("This page is incomplete.");
    fromAddress();
    build();
    scale();
    sync();
    pointers();
    keys();
    start();
  } catch (error) {
    fail(error);
  }
})();
