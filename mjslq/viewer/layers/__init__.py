"""Layers of a scene: each draws one kind of thing, and can be shown and hidden by itself."""
