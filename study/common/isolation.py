"""A study depends on its settings alone: what libraries would take from the surroundings.

`isolate` is called before anything else is imported. `study.training.fit` and
`study.plotting.style` state again what they need, for callers who do not come from the command
line.

===============  ==================================================  ===========================
library          reads                                               here
===============  ==================================================  ===========================
Lightning        ``SLURM_*``, ``RANK``, ``WORLD_SIZE``, … of         removed
                 clusters, ``PL_*``
torch            ``TORCH_*``, ``ATEN_*``, ``DNNL_*``, …              removed
cuBLAS           ``CUBLAS_WORKSPACE_CONFIG``                         a reproducible value
OpenMP and BLAS  ``OMP_*``, ``MKL_*``, ``OPENBLAS_*``, …             removed; `engine.threads`
NumPy and alike  ``NPY_*``, ``SCIPY_*``, ``PANDAS_*``, …             removed
Matplotlib       ``MPLBACKEND``                                      ``agg``
                 ``MATPLOTLIBRC``, ``matplotlibrc``                  removed; `plotting.style`
                                                                     begins at the defaults
Rerun            ``RERUN``, ``RERUN_*``                              removed
                 ``RUST_LOG``                                        errors alone
Dask             ``DASK_*``, ``~/.config/dask``, ``/etc/dask``       removed; `workflow.engine`
                                                                     begins at the defaults
                 the same, ``distributed.comm`` alone                kept: how to connect to the
                                                                     scheduler `engine.address`
Optuna           ``OPTUNA_*``                                        removed
fsspec           ``FSSPEC_*``                                        removed
jsonargparse     ``JSONARGPARSE_*``                                  removed
MuJoCo           ``PYOPENGL_PLATFORM``                               removed
                 ``MUJOCO_GL``                                       removed but for ``glfw``: a
                                                                     missing library would end
                                                                     the import of MuJoCo
Python           ``PYTHONWARNINGS``, ``-W``                          as without
                 ``PYTHONOPTIMIZE``, ``-O``                          refused
                 locale, ``PYTHONIOENCODING``                        what a terminal cannot show
                                                                     is replaced
===============  ==================================================  ===========================

Kept are variables that say where something is or which hardware is used (``HOME``, ``TMPDIR``,
``XDG_*``, ``MPLCONFIGDIR``, ``CUDA_VISIBLE_DEVICES``, ``CC``), and the study's own,
``STUDY_COMPILED`` (`study.models.unroll.compiler`) and ``STUDY_GRAPHS`` (`graphs`, beside it).
"""

import io
import os
import sys
import warnings

from study.common.errors import BadInput

PREFIXES = (
    # Lightning
    *("SLURM_", "LSB_", "JSM_NAMESPACE_", "TORCHELASTIC_", "PL_", "LT_", "XLA_", "XRT_"),
    # torch
    *("TORCH_", "TORCHDYNAMO_", "TORCHINDUCTOR_", "ATEN_", "DNNL_", "ONEDNN_", "NVIDIA_TF32_"),
    # OpenMP and BLAS
    *("OMP_", "GOMP_", "KMP_", "MKL_", "OPENBLAS_", "GOTO_", "BLIS_", "VECLIB_", "NUMEXPR_"),
    # NumPy and alike
    *("NPY_", "NUMPY_", "SCIPY_", "PANDAS_"),
    # Matplotlib, Rerun, Dask, Optuna, fsspec, jsonargparse
    *("MPL_", "RERUN_", "_RERUN_", "OTEL_", "DASK_", "OPTUNA_", "FSSPEC_", "JSONARGPARSE_"),
)
"""Beginnings of the variables that are removed."""

VARIABLES = (
    *("RANK", "LOCAL_RANK", "NODE_RANK", "GROUP_RANK"),
    *("WORLD_SIZE", "LOCAL_WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT", "STANDALONE_PORT"),
    *("PYTORCH_JIT", "MATPLOTLIBRC", "RERUN", "TELEMETRY_ENABLED", "PYOPENGL_PLATFORM"),
    "PYTHONWARNINGS",
)
"""Variables that are removed."""

KEPT = ("KMP_DUPLICATE_LIB_OK", "SLURM_CONF")
"""Without the first, some installations on macOS end when they load torch. The second names the
settings of SLURM, which `sbatch` reads."""

KEPT_PREFIX = "DASK_DISTRIBUTED__COMM__"
"""Begins the variables that say how to connect to a Dask scheduler, such as its certificates."""

VALUES = {
    "MPLBACKEND": "agg",
    "RUST_LOG": "error",
    "CUBLAS_WORKSPACE_CONFIG": ":4096:8",
    # NumPy computes in one thread, whatever the number of cores.
    "OPENBLAS_NUM_THREADS": "1",
}
"""Variables that are set."""

IGNORED = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)
"""Warnings that Python does not show."""


def isolate() -> None:
    """Bring this process, and those that it starts, into the same state in any surroundings.

    Raises:
        BadInput: the study cannot run in them.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    if sys.flags.optimize:
        raise BadInput("python -O, or PYTHONOPTIMIZE, drops checks of the study; run it without")
    if os.environ.get("MUJOCO_GL") != "glfw":
        os.environ.pop("MUJOCO_GL", None)
    for name in list(os.environ):
        is_kept = name in KEPT or name.startswith(KEPT_PREFIX)
        if (name in VARIABLES or name.startswith(PREFIXES)) and not is_kept:
            del os.environ[name]
    os.environ.update(VALUES)
    if sys.warnoptions:
        sys.warnoptions.clear()
        warnings.resetwarnings()
        for category in IGNORED:
            warnings.simplefilter("ignore", category)
