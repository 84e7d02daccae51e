"""The rig, or a recorded bag, on a page in the browser: what it shows, and the small server that hands it out."""
