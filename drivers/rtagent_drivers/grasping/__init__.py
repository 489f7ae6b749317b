"""The grasping experiment of Travnik's thesis (chapter 5), modelled: what hand, glove and camera sense."""
