"""Run the numbered examples and keep the pictures that a page shows, small, in images/gallery."""

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

DOCS = Path(__file__).resolve().parent
LARGEST = 190_000  # bytes
EXAMPLES = sorted((DOCS.parent / "examples").glob("[0-9][0-9]_*.py"))


def pack(source: Path, target: Path, largest: int = LARGEST) -> None:
    """Copy a PNG, with fewer colors where it would be large."""
    picture = Image.open(source).convert("RGB")
    for n_colors in (None, 256, 128, 64, 32):
        kept = picture.quantize(n_colors, kmeans=3) if n_colors else picture
        kept.save(target, format="PNG", optimize=True)
        if target.stat().st_size < largest:
            return


def main() -> None:
    wanted = sys.argv[1:]
    (DOCS / "images/gallery").mkdir(parents=True, exist_ok=True)
    pages = "".join(page.read_text(encoding="utf-8") for page in DOCS.rglob("*.md"))
    for example in EXAMPLES:
        if wanted and example.stem[:2] not in wanted:
            continue
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([sys.executable, str(example)], cwd=folder, check=True)
            for picture in sorted(Path(folder).glob("*.png")):
                if f"images/gallery/{picture.name}" in pages:
                    pack(picture, DOCS / "images/gallery" / picture.name)


if __name__ == "__main__":
    main()
