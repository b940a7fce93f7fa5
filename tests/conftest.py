"""What the environment says of progress bars is no matter of the tests."""

import os

os.environ.pop("TQDM_DISABLE", None)  # read when tqdm is imported
