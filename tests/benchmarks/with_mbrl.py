"""Python with mbrl 0.2.0 at hand: ``python -m tests.benchmarks.with_mbrl [ARGUMENTS]``.

mbrl pins old versions of what the study needs. So it is installed without them, with what it needs
besides, in a folder of its own that is gone afterwards; the study's environment stays as it is.
ARGUMENTS are those of `python`. Without any, the agreement of the probabilistic MLPs is tested:

    python -m tests.benchmarks.with_mbrl
    python -m tests.benchmarks.with_mbrl -m tests.benchmarks.training
"""

import os
import subprocess
import sys
from tempfile import TemporaryDirectory

PACKAGES = (
    "mbrl==0.2.0",
    "hydra-core==1.3.2",
    "omegaconf==2.3.0",
    "antlr4-python3-runtime==4.9.3",
    "termcolor==2.5.0",
)
AGREEMENT = ("-m", "pytest", "-v", "tests/models/test_mbrl.py")


def run(arguments: list[str]) -> int:
    """Run Python with mbrl; what it returned."""
    with TemporaryDirectory(prefix="mbrl-") as folder:
        install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"]
        done = subprocess.run([*install, "--target", folder, *PACKAGES], check=False)
        if done.returncode:
            return done.returncode
        seen = os.pathsep.join(filter(None, (folder, os.environ.get("PYTHONPATH"))))
        command = [sys.executable, *(arguments or AGREEMENT)]
        return subprocess.run(
            command, env=os.environ | {"PYTHONPATH": seen}, check=False
        ).returncode


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
