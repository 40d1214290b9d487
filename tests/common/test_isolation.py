"""A study depends on its settings alone, whatever the environment variables and user files."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from study.common.isolation import isolate

PROGRAM = """
import sys
from study.common.isolation import isolate
isolate()
from pathlib import Path
out = Path(sys.argv[1])

import matplotlib as mpl
from study.plotting import style
with mpl.rc_context(style.context()):
    figure = style.figure(height=2.0)
    axes = figure.subplots()
    axes.plot([0, 1, 2], [0, 1, 0], label="a label")
    axes.set_title("a_title")
    axes.legend()
    style.save(figure, out / "figure")

from study.common.progress import Progress
from study.config.model_sections import Network
from study.config.settings import Collect, Ensemble
from study.config.stage_settings import CollectSettings, EnsembleSettings, TrainingSet
from study.examples import cart
from study.stages import collect, ensemble
from study.workflow.worker import prepare
prepare((), 1)
for name in ("data", "fit"):
    (out / name).mkdir()
sizes = Collect(trajectories=20, validation=4, scenarios=2, rollouts=2, horizon=10)
collect.run(CollectSettings("cart", sizes), {}, out / "data", Progress())
small = Ensemble(members=2, hidden_size=4, steps=8, validate_every=4)
settings = EnsembleSettings(TrainingSet(0, 20), seed=0, ensemble=small, network=Network())
ensemble.run(settings, {"data": out / "data"}, out / "fit", Progress())

import rerun.blueprint as rrb
from study.recording.streams import recording, send_scalars
with recording(out / "numbers.rrd", "test", {}, rrb.Blueprint()) as stream:
    send_scalars(stream, "numbers", "step", range(9), range(9))
"""

CLUSTER = {"MASTER_ADDR": "10.0.0.1", "MASTER_PORT": "1", "WORLD_SIZE": "4"}
SURROUNDINGS = {
    "slurm": {
        "SLURM_PROCID": "1",
        "SLURM_LOCALID": "1",
        "SLURM_NTASKS": "4",
        "SLURM_JOB_NAME": "job",
        "SLURM_JOB_ID": "7",
    },
    "ranks": {
        "RANK": "1",
        "LOCAL_RANK": "1",
        "NODE_RANK": "1",
        "GROUP_RANK": "1",
        "TORCHELASTIC_RUN_ID": "1",
        "KUBERNETES_PORT": "tcp://10.0.0.1:443",
        **CLUSTER,
    },
    "lsf": {
        "LSB_JOBID": "1",
        "LSB_DJOB_RANKFILE": "/nowhere",
        "JSM_NAMESPACE_RANK": "1",
        "JSM_NAMESPACE_LOCAL_RANK": "1",
        "JSM_NAMESPACE_SIZE": "2",
        "RANK": "none",
    },
    "libraries": {
        "PL_TRAINER_MAX_STEPS": "1",
        "PL_TRAINER_FAST_DEV_RUN": "1",
        "ATEN_CPU_CAPABILITY": "default",
        "OMP_NUM_THREADS": "3",
        "MKL_NUM_THREADS": "3",
        "MPLBACKEND": "module://no_such_backend",
        "MATPLOTLIBRC": "matplotlibrc",
        "RERUN": "off",
        "RERUN_STRICT": "1",
        "RERUN_CHUNK_MAX_ROWS": "2",
        "MUJOCO_GL": "osmesa",
        "PYOPENGL_PLATFORM": "osmesa",
    },
    "python": {
        "PYTHONWARNINGS": "error",
        "PYTHONHASHSEED": "7",
        "LC_ALL": "C",
        "PYTHONIOENCODING": "ascii",
        "PYTHONUTF8": "0",
        "PYTHONCOERCECLOCALE": "0",
    },
}

MATPLOTLIBRC = """
text.usetex: True
axes.prop_cycle: cycler(color=["red"])
axes.facecolor: yellow
savefig.bbox: tight
"""


def _files(folder: Path, **variables: str) -> dict[str, bytes]:
    """What the program writes, run in a folder with a ``matplotlibrc`` if there are variables."""
    folder.mkdir()
    if variables:
        (folder / "matplotlibrc").write_text(MATPLOTLIBRC, encoding="utf-8")
    root = str(Path(__file__).parents[2])
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, "out"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": root} | variables,
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert done.returncode == 0, done.stderr
    files = [path for path in (folder / "out").rglob("*") if path.is_file()]
    # A recording has a random identity.
    return {path.name: path.read_bytes() * (".rrd" not in path.name) for path in files}


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    files = _files(tmp_path_factory.mktemp("surroundings") / "clean")
    assert {"figure.png", "figure.pdf", "numbers.rrd", "metrics.csv"} < set(files)
    return files


@pytest.mark.slow
@pytest.mark.parametrize("variables", SURROUNDINGS.values(), ids=SURROUNDINGS)
def test_the_surroundings_change_no_byte(
    clean: dict[str, bytes], tmp_path: Path, variables: dict[str, str]
) -> None:
    assert _files(tmp_path / "there", **variables) == clean


def test_python_without_assertions_is_refused() -> None:
    program = [sys.executable, "-O", "-m", "study.run", "--help"]
    done = subprocess.run(program, capture_output=True, encoding="utf-8", check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "PYTHONOPTIMIZE" in done.stderr


def test_places_and_hardware_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = {"HOME": "/x", "TMPDIR": "/y", "CUDA_VISIBLE_DEVICES": "1", "MUJOCO_GL": "glfw"}
    kept["DASK_DISTRIBUTED__COMM__TLS__CA_FILE"] = "/z/ca.pem"
    removed = {"SLURM_PROCID": "1", "RANK": "1", "DASK_CONFIG": "/z", "MATPLOTLIBRC": "/z"}
    for name, value in (kept | removed).items():
        monkeypatch.setenv(name, value)
    isolate()
    assert {name: os.environ.get(name) for name in kept} == kept
    assert not removed.keys() & os.environ.keys()
