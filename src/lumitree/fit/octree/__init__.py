"""The octree of a lamp, from traced rays: estimation and refinement."""
