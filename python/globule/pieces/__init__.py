"""Scenes, and particles beyond one memory: pieces one after the other, or one on each rank
(docs/design/pieces.md)."""
