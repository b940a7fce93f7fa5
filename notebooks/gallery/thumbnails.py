"""Draw the small pictures of the gallery: python notebooks/gallery/thumbnails.py."""

import base64
import io
import json
from pathlib import Path

from PIL import Image

HERE = Path(__file__).parent
WIDTH = 420

for page in sorted(HERE.glob("*.ipynb")):
    cells = json.loads(page.read_text("utf-8"))["cells"]
    data = (x.get("data", {}) for cell in cells for x in cell.get("outputs", []))
    first = next(x["image/png"] for x in data if "image/png" in x)
    picture = Image.open(io.BytesIO(base64.b64decode(first))).convert("RGB")
    picture.thumbnail((WIDTH, WIDTH), Image.Resampling.LANCZOS)
    picture.quantize(64).save(HERE / "thumbnails" / f"{page.stem}.png", optimize=True)
