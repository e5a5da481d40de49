// The types of three.js, which is generated.
export * from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
