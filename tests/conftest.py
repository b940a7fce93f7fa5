"""What the environment says of progress bars and of Ctrl-C is no matter of the tests."""

import os
import signal

os.environ.pop("TQDM_DISABLE", None)  # read when tqdm is imported
# where a script starts the tests in its background, Ctrl-C is ignored
signal.signal(signal.SIGINT, signal.default_int_handler)
