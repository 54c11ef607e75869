const int MATERIAL = 0, LEVELS = 1, ANSWER = 2, ERROR = 3;
layout(location = 0) out vec4 colour;
// offset and size of what is drawn, in pixels of the canvas, from its lower left.
uniform vec4 window;
uniform highp sampler2D picture, reference;
uniform float exposure, largest;
uniform int view;
uniform bool bottom_up;

vec3 encoded(vec3 c) {
  c = clamp(c, 0.0, 1.0);
  return mix(12.92 * c, 1.055 * pow(max(c, 1e-6), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}

// From black over violet and orange to a light yellow: brighter is more, in grey too.
vec3 ramp(float t) {
  const vec3 STOPS[6] = vec3[6](
    vec3(0.02, 0.02, 0.06), vec3(0.20, 0.07, 0.42), vec3(0.53, 0.13, 0.48),
    vec3(0.86, 0.28, 0.34), vec3(0.98, 0.60, 0.25), vec3(1.00, 0.96, 0.70)
  );
  t = clamp(t, 0.0, 1.0) * 5.0;
  int k = min(int(t), 4);
  return mix(STOPS[k], STOPS[k + 1], t - float(k));
}

vec4 at(sampler2D image, vec2 q) {
  ivec2 size = textureSize(image, 0);
  ivec2 pixel = clamp(ivec2(q * vec2(size)), ivec2(0), size - 1);
  return texelFetch(image, pixel, 0);
}

vec3 ground(vec2 q) {
  return mix(vec3(0.024), vec3(0.011), smoothstep(0.0, 0.75, length(q - vec2(0.5, 0.55))));
}

void main() {
  vec2 q = (gl_FragCoord.xy - window.xy) / window.zw;
  if (!bottom_up) q.y = 1.0 - q.y;
  vec3 shown;
  if (view == ERROR) {
    vec3 apart = abs(at(picture, q).rgb - at(reference, q).rgb);
    colour = vec4(ramp(dot(apart, vec3(1.0 / 3.0)) / largest), 1);
    return;
  }
  vec4 c = view == MATERIAL || view == LEVELS ? texture(picture, q) : at(picture, q);
  if (view == LEVELS) shown = mix(encoded(ground(q)), ramp(0.08 + 0.92 * c.r / largest / max(c.a, 1e-3)), c.a);
  else if (view == ANSWER) shown = encoded(c.rgb * exposure);
  else shown = encoded(c.rgb * exposure + ground(q) * (1.0 - c.a));
  // Half a step of noise: dark gradients have no bands.
  float noise = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715)))) - 0.5;
  colour = vec4(shown + noise / 255.0, 1);
}
