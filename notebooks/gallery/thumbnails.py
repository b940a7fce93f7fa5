"""Draw the small pictures of the gallery: python notebooks/gallery/thumbnails.py.

A page with an animation shows one of its frames, another page one panel of its first figure.
"""

import base64
import io
import json
import re
from html import unescape
from pathlib import Path

from PIL import Image, ImageChops

HERE = Path(__file__).parent
SIZE = (420, 300)
#: The panel of the first figure that is shown: left, upper, right, lower, as parts of the figure.
PANELS = {
    "argon_crystal": (0, 0, 0.41, 1),
    "arm_from_urdf": (0.53, 0.06, 0.9, 0.475),
    "ball_on_a_shaking_table": (0, 0, 0.36, 1),
    "block_on_a_belt": (0, 0, 0.36, 1),
    "cloth": (0, 0.5, 0.33, 1),
    "duffing": (0.5, 0, 1, 1),
    "falling_quadruped": (0, 0, 0.36, 1),
    "families_of_orbits": (0.67, 0, 1, 1),
    "folds_and_doublings": (0.51, 0, 1, 1),
    "foucault": (0.36, 0, 0.645, 1),
    "halo_orbits": (0, 0, 0.44, 1),
    "hanging_chain": (0.33, 0, 0.675, 1),
    "heavy_top_through_the_pole": (0, 0, 0.41, 1),
    "hopping_leg": (0, 0, 0.36, 1),
    "kapitza": (0, 0, 0.55, 1),
    "kerr_orbit": (0, 0, 0.43, 1),
    "leapfrogging_vortices": (0, 0, 0.6, 1),
    "normal_modes": (0.6, 0, 1, 1),
    "outer_solar_system": (0, 0, 0.47, 1),
    "penning_trap": (0, 0, 0.385, 1),
    "puma_arm": (0, 0, 0.43, 1),
    "restricted_three_bodies": (0.55, 0, 1, 1),
    "rimless_wheel": (0.34, 0, 0.69, 1),
    "rocking_block": (0, 0, 0.36, 1),
    "swinging_atwood": (0, 0, 0.325, 1),
    "toda_lattice": (0, 0, 0.5, 1),
    "water_molecule": (0, 0, 0.485, 1),
}
#: The part of an animation at which its frame is taken, if not a third.
FRAMES = {"impacts": 0.15}


def picture(name: str, outputs: list[dict[str, str]]) -> Image.Image:
    """Return a frame of the first animation, or a panel of the first figure."""
    for data in outputs:
        frames = re.findall(
            r"data:image/\w+;base64,([A-Za-z0-9+/=]+)", unescape(data.get("text/html", ""))
        )
        if len(frames) > 1:
            frame = frames[int(FRAMES.get(name, 1 / 3) * len(frames))]
            return Image.open(io.BytesIO(base64.b64decode(frame))).convert("RGB")
    first = next(data["image/png"] for data in outputs if "image/png" in data)
    whole = Image.open(io.BytesIO(base64.b64decode(first))).convert("RGB")
    left, upper, right, lower = PANELS.get(name, (0, 0, 1, 1))
    return whole.crop(
        (
            int(left * whole.width),
            int(upper * whole.height),
            int(right * whole.width),
            int(lower * whole.height),
        )
    )


def main() -> None:
    """Write all pictures, without white margins."""
    for page in sorted(HERE.glob("*.ipynb")):
        cells = json.loads(page.read_text("utf-8"))["cells"]
        outputs = [x.get("data", {}) for cell in cells for x in cell.get("outputs", [])]
        for data in outputs:
            if isinstance(data.get("text/html"), list):
                data["text/html"] = "".join(data["text/html"])
        image = picture(page.stem, outputs)
        white = Image.new("RGB", image.size, "white")
        image = image.crop(ImageChops.difference(image, white).getbbox())
        image.thumbnail(SIZE, Image.Resampling.LANCZOS)
        image.quantize(64).save(HERE / "thumbnails" / f"{page.stem}.png", optimize=True)


if __name__ == "__main__":
    main()
