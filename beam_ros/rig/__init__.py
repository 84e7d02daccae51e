"""The rig as one object, and the camera that films it."""
