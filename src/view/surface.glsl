// Shapes with parameters s in [0, 1]^2; the two that a ray meets in closed form are in scene.frag.
const int PLANE = 0, SPHERE = 1, TORUS = 2, CLOTH = 3, QUERIES = 4;
const float PI = 3.14159265358979;
// A program a shape: some devices execute every branch.
const int shape = SHAPE;

const float RING = 0.72, TUBE = 0.32;
vec3 torus(vec2 s) {
  float a = 2.0 * PI * s.x, b = 2.0 * PI * s.y;
  return vec3((RING + TUBE * cos(b)) * vec2(cos(a), sin(a)), TUBE * sin(b));
}

// A square sheet over a round table: flat, then an arc, then hanging in folds. Lengths along the radius are kept.
const float HALF_SIDE = 0.95, FLAT = 0.44, BEND = 0.2, FALL = 1.3;
vec3 cloth(vec2 s) {
  vec2 q = HALF_SIDE * (2.0 * s - 1.0);
  float r = length(q), a = atan(q.y, q.x);
  float bend = clamp((r - FLAT) / BEND, 0.0, FALL);
  float rest = max(r - FLAT - BEND * FALL, 0.0);
  float away = min(r, FLAT) + BEND * sin(bend) + rest * cos(FALL);
  float down = BEND * (1.0 - cos(bend)) + rest * sin(FALL);
  float hang = max(r - FLAT, 0.0);
  float fold = 0.66 * cos(9.0 * a + 0.4) + 0.3 * cos(5.0 * a + 1.3) + 0.16 * cos(14.0 * a);
  away += 0.34 * hang * hang / (0.2 + hang) * fold;
  return vec3(r > 0.0 ? q * (away / r) : q, 0.46 - down);
}

vec3 surface(vec2 s) { return shape == TORUS ? torus(s) : cloth(s); }
