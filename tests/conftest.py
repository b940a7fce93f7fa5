"""What the environment says of progress bars and of Ctrl-C is no matter of the tests.

They make hundreds of steppers for a run each: what it does not need is not compiled.
"""

import os
import signal

os.environ["SYMSIMPSON_COMPILE"] = "late"
os.environ.pop("TQDM_DISABLE", None)  # read when tqdm is imported
# where a script starts the tests in its background, Ctrl-C is ignored
signal.signal(signal.SIGINT, signal.default_int_handler)
