const int MOST_LIGHTS = 8;
const int LEVELS = 1, view = VIEW;
in vec2 st;
layout(location = 0) out vec4 colour;
// right and up reach from the middle of the picture to its edges at depth 1; pitch is a pixel's side there.
uniform vec3 eye, forward, right, up;
uniform float pitch;
uniform vec2 size, jitter, tiling;
uniform float texels, bias;
uniform int lights;
uniform vec3 light[MOST_LIGHTS], irradiance[MOST_LIGHTS];
uniform bool cosine;
uniform mat4 shadow[MOST_LIGHTS];
uniform highp sampler2DArrayShadow shadows;
uniform highp sampler2D queries_u_wi, queries_wo_level;

// What a pixel sees: a point, what it moves by with the parameters, and the normal.
struct Hit { bool any; vec3 p, du, dv, n; vec2 s; };

Hit hit_plane(vec3 d) {
  float t = -eye.z / d.z;
  vec3 p = eye + t * d;
  bool any = t > 0.0 && max(abs(p.x), abs(p.y)) <= 1.0;
  return Hit(any, p, vec3(2, 0, 0), vec3(0, 2, 0), vec3(0, 0, 1), 0.5 * p.xy + 0.5);
}

Hit hit_sphere(vec3 d) {
  vec3 e = normalize(d);
  float b = dot(eye, e);
  vec3 nearest = eye - b * e;
  float square = 1.0 - dot(nearest, nearest);
  // From the point nearest to the centre: the distance of the eye costs no digits.
  vec3 p = normalize(nearest - sqrt(max(square, 0.0)) * e);
  float across = max(length(p.xy), 1e-6);
  vec2 round = across > 1e-6 ? p.xy / across : vec2(1, 0);
  float phi = atan(round.y, round.x);
  vec2 s = vec2((phi < 0.0 ? phi + 2.0 * PI : phi) / (2.0 * PI), atan(across, p.z) / PI);
  vec3 du = 2.0 * PI * across * vec3(-round.y, round.x, 0), dv = PI * vec3(p.z * round, -across);
  return Hit(square >= 0.0 && b < 0.0, p, du, dv, p, s);
}

Hit hit_mesh() {
  // Central differences; the sheet has no closed form worth writing down.
  const float STEP = 1.0 / 1024.0;
  vec3 du = (surface(st + vec2(STEP, 0)) - surface(st - vec2(STEP, 0))) / (2.0 * STEP);
  vec3 dv = (surface(st + vec2(0, STEP)) - surface(st - vec2(0, STEP))) / (2.0 * STEP);
  vec3 p = surface(st), n = normalize(cross(du, dv));
  // The sheet has the material on both sides.
  if (shape == CLOTH && dot(n, eye - p) < 0.0) n = -n;
  return Hit(true, p, du, dv, n, st);
}

// Share of light k that arrives: four taps of a map that compares and filters.
float lit(int k, vec3 p, vec3 n) {
  if (shape != TORUS && shape != CLOTH) return 1.0;
  vec3 at = (shadow[k] * vec4(p + 0.012 * n, 1.0)).xyz * 0.5 + 0.5;
  float side = 1.0 / float(textureSize(shadows, 0).x), sum = 0.0;
  for (int i = 0; i < 4; i++) {
    vec2 tap = at.xy + side * (vec2(i & 1, i >> 1) * 1.5 - 0.75);
    sum += texture(shadows, vec4(tap, float(k), at.z - 0.002));
  }
  return 0.25 * sum;
}

void main() {
  vec2 u, wo, asked = vec2(0);
  float level, up_wo = 1.0;
  Hit hit = Hit(true, vec3(0), vec3(1, 0, 0), vec3(0, 1, 0), vec3(0, 0, 1), vec2(0));
  vec3 x = hit.du, y = hit.dv;
  if (shape == QUERIES) {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 a = texelFetch(queries_u_wi, pixel, 0), b = texelFetch(queries_wo_level, pixel, 0);
    u = a.xy;
    asked = a.zw;
    wo = b.xy;
    level = b.z;
  } else {
    vec2 ndc = (gl_FragCoord.xy + jitter) / size * 2.0 - 1.0;
    vec3 d = forward + ndc.x * right + ndc.y * up;
    if (shape == PLANE) hit = hit_plane(d);
    else if (shape == SPHERE) hit = hit_sphere(d);
    else hit = hit_mesh();
    float depth = dot(hit.p - eye, forward);
    d = (hit.p - eye) / depth;
    x = normalize(hit.du - hit.n * dot(hit.n, hit.du));
    y = cross(hit.n, x);
    if (dot(y, hit.dv) < 0.0) y = -y;
    vec3 o = -normalize(d);
    up_wo = dot(hit.n, o);
    wo = vec2(dot(x, o), dot(y, o));
    u = hit.s * tiling;
    // The pixel's footprint on the tangent plane over the area that one unit of s covers.
    float footprint = depth * depth * pitch * pitch / max(abs(dot(hit.n, d)), 1e-6);
    float unit = max(length(cross(hit.du, hit.dv)), 1e-12);
    level = 0.5 * log2(max(footprint / unit * tiling.x * tiling.y * texels, 1e-12)) + bias;
  }
  if (!hit.any) {
    colour = vec4(0);
    return;
  }
  if (view == LEVELS) {
    colour = vec4(vec3(level), 1);
    return;
  }
  vec3 sum = vec3(0);
  if (up_wo > 0.0) {
    NeumipPrepared prepared = neumip_prepare(u, level, wo);
    for (int k = 0; k < lights; k++) {
      float up_wi = shape == QUERIES ? 1.0 : dot(hit.n, light[k]);
      if (up_wi <= 0.0) continue;
      vec2 wi = shape == QUERIES ? asked : vec2(dot(x, light[k]), dot(y, light[k]));
      vec3 answer = neumip_evaluate(prepared, wi);
      sum += answer * irradiance[k] * (cosine || shape == QUERIES ? 1.0 : up_wi) * lit(k, hit.p, hit.n);
    }
  }
  colour = vec4(sum, 1);
}
