// How points are drawn: their size and colour, and the shade at the edges of depth.

import { GLSL3, ShaderMaterial, Vector2, Vector3 } from "./three.js";

/** How a point comes by its colour. */
export const MODES = { plain: 0, rgb: 1, scalar: 2, category: 3, normal: 4, height: 5 };

/** The colours of a scale, dark to light, and those of categories: from 0 to 255. The page's legend has them, too. */
export const SCALE = [[46, 30, 110], [35, 98, 170], [22, 150, 150], [120, 192, 84], [252, 231, 88]];
export const CATEGORIES = [
  [150, 150, 156], [190, 160, 110], [166, 118, 72], [150, 205, 110], [84, 170, 80], [30, 120, 56], [214, 74, 60],
  [120, 60, 160], [240, 150, 50], [50, 130, 220], [90, 90, 100], [236, 112, 168], [70, 190, 190], [250, 220, 80],
  [110, 80, 220], [140, 40, 60],
];

const list = colours => colours.map(colour => `vec3(${colour.map(part => (part / 255).toFixed(4)).join(",")})`).join(",");

const POINT_VERTEX = `
uniform int mode, upAxis;
uniform vec2 range;
uniform vec3 plain, least, greatest;
uniform float size, smallest, largest;
in vec4 colour;
in float scalar;
in vec3 direction;
out vec3 shade;
const vec3 scale[${SCALE.length}] = vec3[](${list(SCALE)});
const vec3 categories[${CATEGORIES.length}] = vec3[](${list(CATEGORIES)});
vec3 scaled(float value) {
  if (isnan(value)) return vec3(0.5);
  float at = clamp((value - range.x) / max(range.y - range.x, 1e-30), 0.0, 1.0) * ${(SCALE.length - 1).toFixed(1)};
  int below = min(int(at), ${SCALE.length - 2});
  return mix(scale[below], scale[below + 1], at - float(below));
}
void main() {
  vec4 world = modelMatrix * vec4(position, 1.0);
  if (any(lessThan(world.xyz, least)) || any(greaterThan(world.xyz, greatest))) {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    return;
  }
  vec4 seen = viewMatrix * world;
  gl_Position = projectionMatrix * seen;
  gl_PointSize = clamp(size / max(-seen.z, 1e-30), smallest, largest);
  if (mode == ${MODES.rgb}) shade = colour.rgb;
  else if (mode == ${MODES.scalar}) shade = scaled(scalar);
  else if (mode == ${MODES.category}) shade = categories[int(scalar) % ${CATEGORIES.length}];
  else if (mode == ${MODES.normal}) shade = 0.5 + 0.5 * normalize(direction + 1e-9);
  else if (mode == ${MODES.height}) shade = scaled(world[upAxis]);
  else shade = plain;
}`;

const POINT_FRAGMENT = `
in vec3 shade;
out vec4 drawn;
void main() {
  vec2 off = gl_PointCoord - 0.5;
  if (dot(off, off) > 0.25) discard;
  drawn = vec4(shade, 1.0);
}`;

export function pointMaterial() {
  return new ShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: POINT_VERTEX,
    fragmentShader: POINT_FRAGMENT,
    uniforms: {
      mode: { value: 0 },
      upAxis: { value: 2 },
      range: { value: new Vector2(0, 1) },
      plain: { value: new Vector3(0.62, 0.66, 0.72) },
      least: { value: new Vector3() },
      greatest: { value: new Vector3() },
      size: { value: 1 },
      smallest: { value: 1 },
      largest: { value: 40 },
    },
  });
}

const SCREEN_VERTEX = `
out vec2 at;
void main() {
  at = position.xy * 0.5 + 0.5;
  gl_Position = vec4(position.xy, 0.0, 1.0);
}`;

// Eye-dome lighting: what lies behind a neighbour on the screen is darker, so that shapes show without normals. Where most
// neighbours are nearer, it is a gap between points that something further away is seen through: it is closed.
const SCREEN_FRAGMENT = `
uniform sampler2D drawing, depth;
uniform vec2 pixel, planes;
uniform float strength;
in vec2 at;
out vec4 drawn;
const float beyond = 1e3, step = 0.03;
float far(vec2 where) {
  float d = texture(depth, where).x;
  return d >= 1.0 ? beyond : log2(planes.x * planes.y / (planes.y - d * (planes.y - planes.x)));
}
void main() {
  vec4 colour = texture(drawing, at);
  float own = far(at), behind = 0.0;
  vec4 nearer = vec4(0.0);
  for (int i = 0; i < 8; i++) {
    float angle = float(i) * 0.7853982;
    vec2 where = at + pixel * vec2(cos(angle), sin(angle));
    float before = own - far(where);
    if (before > step) nearer += vec4(texture(drawing, where).rgb, 1.0);
    behind += max(0.0, before);
  }
  if (nearer.a > 5.5) drawn = vec4(nearer.rgb / nearer.a, 1.0);
  else if (own == beyond) drawn = colour;
  else drawn = vec4(colour.rgb * max(0.3, exp(-strength * behind / 8.0)), 1.0);
}`;

export function screenMaterial() {
  return new ShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: SCREEN_VERTEX,
    fragmentShader: SCREEN_FRAGMENT,
    depthTest: false,
    depthWrite: false,
    transparent: false,
    uniforms: {
      drawing: { value: null },
      depth: { value: null },
      pixel: { value: new Vector2() },
      planes: { value: new Vector2() },
      strength: { value: 0 },
    },
  });
}
