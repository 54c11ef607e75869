// The bundle's golden answers by this page's shaders, and how long a frame takes where that is asked for.
const TIMED_FRAMES = 9;
const TIMED_SIDE = 256;

function golden(data, numbers) {
  const part = (name) => floats(numbers, data.numbers.golden[name]);
  return { u: part("u"), wi: part("wi"), wo: part("wo"), level: part("level"), rgb: part("rgb") };
}

// Largest |difference| / (1 + |value|), its mean, and how many values exceed the tolerance.
function compared(answers, expected, tolerance) {
  let [largest, sum, beyond] = [0, 0, 0];
  expected.forEach((value, i) => {
    const off = Math.abs(answers[i] - value) / (1 + Math.abs(value));
    // What is no number is beyond every tolerance.
    if (!(off <= tolerance)) beyond += 1;
    largest = Number.isFinite(off) ? Math.max(largest, off) : Infinity;
    sum += off;
  });
  return { values: expected.length, largest: String(largest), mean: String(sum / expected.length), beyond };
}

// Milliseconds of a square frame that the plane fills, first and median of several; reading a pixel waits for it.
function timed(engine, mode) {
  const side = TIMED_SIDE;
  const target = engine.target("timed", side, side, { depth: true });
  const pixel = new Float32Array(4);
  const times = [];
  for (let k = 0; k <= TIMED_FRAMES; k++) {
    const angle = 0.1 * k;
    const camera = { origin: [0, 0, 2], target: [0, 0, 0], up: [0, 1, 0], fov: 50 };
    const light = { direction: unit([0.6 * Math.cos(angle), 0.6 * Math.sin(angle), 0.8]), irradiance: [1, 1, 1] };
    const start = performance.now();
    engine.draw(target, { shape: "plane", tiling: [2, 2], camera, lights: [light], mode }, true);
    engine.gl.bindFramebuffer(engine.gl.FRAMEBUFFER, target.frame);
    engine.gl.readPixels(side / 2, side / 2, 1, 1, engine.gl.RGBA, engine.gl.FLOAT, pixel);
    times.push(performance.now() - start);
  }
  const [first, ...rest] = times;
  rest.sort((a, b) => a - b);
  return { side, first, median: rest[rest.length >> 1], fastest: rest[0], slowest: rest[rest.length - 1] };
}

function selftest(engine, data, numbers, times) {
  const expected = golden(data, numbers);
  const result = { material: data.name, tolerance: data.tolerance, modes: {} };
  const debug = engine.gl.getExtension("WEBGL_debug_renderer_info");
  result.renderer = engine.gl.getParameter(debug ? debug.UNMASKED_RENDERER_WEBGL : engine.gl.RENDERER);
  for (const mode of Object.keys(data.shader.modes)) {
    const answers = compared(engine.answer(expected, mode), expected.rgb, data.tolerance);
    result.modes[mode] = { golden: answers };
    if (times) result.modes[mode].milliseconds = timed(engine, mode);
  }
  result.right = result.modes.exact.golden.beyond === 0;
  result.problem = engine.gl.getError();
  return result;
}
