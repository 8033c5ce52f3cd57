"""The capture folder: one recorded motion of one object, with cameras, masks, tracks and rest geometry."""
