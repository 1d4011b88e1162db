"""What turns traced light into an asset: the octree, the light field, the network."""
