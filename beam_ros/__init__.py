"""The rig: nodes, hub, camera, bags and the ``beam`` command."""
