// What the page uses of three.js: build.js makes src/three.js of it.
export {
  BufferAttribute,
  BufferGeometry,
  Color,
  DepthTexture,
  GLSL3,
  Group,
  LineBasicMaterial,
  LineSegments,
  Mesh,
  NearestFilter,
  OrthographicCamera,
  PerspectiveCamera,
  Points,
  Scene,
  ShaderMaterial,
  UnsignedIntType,
  Vector2,
  Vector3,
  WebGLRenderer,
  WebGLRenderTarget,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
