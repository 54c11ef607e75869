// What shines: one distant light, or a sky with a large lamp where that light is, as many distant lights over the frames.
const IRRADIANCE = Math.PI;
const SKY_LIGHTS = 4;
// Shares of the irradiance that a facing plane gets from the lamp, a lamp behind, and the sky, and how sharp the lamps are.
const LAMP = { power: 0.8, sharpness: 28 };
const RIM = { power: 0.25, sharpness: 9 };
const SKY = { power: 0.35 };

function halton(index, base) {
  let [value, step] = [0, 1];
  for (let i = index; i > 0; i = Math.floor(i / base)) {
    step /= base;
    value += step * (i % base);
  }
  return value;
}

// A direction around an axis: of density proportional to exp(sharpness cos), or everywhere alike.
function around(axis, sharpness, [a, b]) {
  const z = sharpness ? 1 + Math.log(a + (1 - a) * Math.exp(-2 * sharpness)) / sharpness : 1 - 2 * a;
  const r = Math.sqrt(Math.max(0, 1 - z * z));
  const side = unit(cross(Math.abs(axis[2]) > 0.9 ? [1, 0, 0] : [0, 0, 1], axis));
  const other = cross(axis, side);
  const [c, s] = [r * Math.cos(2 * Math.PI * b), r * Math.sin(2 * Math.PI * b)];
  return axis.map((v, i) => z * v + c * side[i] + s * other[i]);
}

// The lights of frame `index`. A lamp's light has all of its power, divided by how often a lamp is drawn.
function lightsOf(kind, direction, index) {
  if (kind === "one") return [{ direction, irradiance: [IRRADIANCE, IRRADIANCE, IRRADIANCE] }];
  const rim = unit([-direction[0], -direction[1], 0.35 * Math.abs(direction[2]) + 0.25]);
  // Half of the frame's lights are the lamp's.
  const parts = [LAMP, LAMP, RIM, SKY];
  return parts.map((part, k) => {
    const at = 1 + index * 2 + (k === 1 ? 1 : 0);
    const pair = [halton(at, 2), halton(at, 3)];
    const axis = part === RIM ? rim : part === SKY ? [0, 0, 1] : direction;
    const found = around(axis, part.sharpness, pair);
    // A sphere of sky gives a plane a quarter of what it sends in all directions: the mean of max(cos, 0).
    const power = part === LAMP ? part.power / 2 : part === SKY ? part.power * 4 : part.power;
    const tint = part === LAMP ? [1.03, 1, 0.95] : part === RIM ? [0.86, 0.96, 1.18] : [0.92, 0.99, 1.12];
    const up = part === SKY ? 0.35 + 0.65 * (0.5 + 0.5 * found[2]) : 1;
    return { direction: found, irradiance: tint.map((c) => IRRADIANCE * power * up * c) };
  });
}
