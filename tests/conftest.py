"""What the environment says of bars and windows is no matter of the tests."""

import os

os.environ.pop("TQDM_DISABLE", None)  # read when tqdm is imported
os.environ["MPLBACKEND"] = "Agg"
