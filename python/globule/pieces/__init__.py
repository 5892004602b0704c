"""Data sets beyond one memory: pieces, one after the other or one a rank (docs/design/pieces.md)."""
