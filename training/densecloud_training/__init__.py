"""Training of the densecloud upsampling cascade: meshes -> point clouds -> trained units -> ONNX files."""
