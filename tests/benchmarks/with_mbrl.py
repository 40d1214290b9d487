"""Python with mbrl 0.2.0: ``python -m tests.benchmarks.with_mbrl [ARGUMENTS]``.

mbrl needs old versions of packages of the study. So it is installed without its requirements, next
to the few that it uses, in a temporary folder. The study's environment does not change. ARGUMENTS
are those of `python`. Without any, the agreement of the two probabilistic MLPs is tested:

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
    """Run Python with mbrl; returns the exit code."""
    with TemporaryDirectory(prefix="mbrl-") as folder:
        install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"]
        installed = subprocess.run([*install, "--target", folder, *PACKAGES], check=False)
        if installed.returncode:
            return installed.returncode
        path = os.pathsep.join(filter(None, (folder, os.environ.get("PYTHONPATH"))))
        command = [sys.executable, *(arguments or AGREEMENT)]
        environment = os.environ | {"PYTHONPATH": path}
        return subprocess.run(command, env=environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
