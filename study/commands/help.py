"""What the command line knows: the commands, what each one takes, and what their help says."""

from typing import Any

COMMANDS = {
    "all": "run the study: whatever is not up to date, then tables, figures, recordings",
    "plan": "say what `all` would run, and for each stage why",
    "status": "say what is done, running or failed, with times",
    "figures": "draw tables and figures again from the results alone",
    "view": "open recordings in the Rerun viewer: view study, view pusher/low/residual_vae/seed-0",
    "compare": "settings that differ and scores of cells, side by side: compare CELL CELL",
    "portrait": "write a page with pictures of an environment, and of how hard its scenarios are",
    "export": "write training data as a Minari data set, to share: export pusher",
    "forecast": "forecast a test scenario, or a plan from a file, with the weights of a study",
    "verify": "check a study's files, draw its tables and figures again, and compare",
    "join": "one study from several that were run apart, each with seeds of its own: join DIR DIR",
    "ablate": "change one choice at a time, and compare what that does on validation data",
}

# These read everything in the results folder itself: they take no settings.
STORED = ("forecast", "verify", "join")
DEFAULT_OUT = "results/quick"

# What a command takes that the others do not: an argument, then flags.
OWN: dict[str, dict[str, dict[str, Any]]] = {
    "view": {
        "cell": {"help": "such as pusher/low/residual_vae/seed-0; or an environment; or study"},
        "--kind": {"default": "forecast", "help": "forecast, scores, training, tuning"},
        "--save": {"help": "folder for a picture of every view, drawn without a screen"},
    },
    "compare": {"cells": {"nargs": "+", "help": "such as pusher/low/residual_vae/seed-0"}},
    "portrait": {
        "environment": {"nargs": "?", "help": "such as pusher; all of the grid by default"},
        "--to": {"help": "folder of the page; OUT/environments by default"},
    },
    "export": {
        "environment": {"help": "such as pusher"},
        "--to": {"help": "folder of Minari data sets; Minari's own by default"},
    },
    "forecast": {
        "--cell": {"required": True, "help": "whose forecaster: uav/high/residual_vae/seed-0"},
        "--scenario": {
            "type": int,
            "help": "a test scenario, from 0 on; with --file, the one whose noise is used",
        },
        "--file": {"help": "a plan of your own, .csv or .json: start, task and actions"},
        "--samples": {"type": int, "help": "forecasts; as many as the study's if not given"},
        "--save": {"help": "recording to write (FILE.rrd), in place of opening the viewer"},
        "--write": {"help": "write the plan to this .csv or .json file, to edit, and do no more"},
        "--out": {"default": DEFAULT_OUT, "help": "results folder"},
    },
    "verify": {
        "out": {"nargs": "?", "default": DEFAULT_OUT, "help": "results folder; results/quick"},
        "--rerun": {"help": "evaluate this cell again from its weights, and compare its scores"},
    },
    "join": {
        "folders": {"nargs": "+", "help": "results folders that differ in their seeds alone"},
        "--out": {"required": True, "help": "results folder to write; it must not be there yet"},
    },
}

EPILOG = {
    "forecast": """\
a plan has these columns, named and in the units of study/envs/README.md:
  s0.NAME      the state at the start, one value:  s0.x, s0.y, …
  task.NAME    what is asked for, one value:       task.target_x, …
  action.NAME  a value for each control step:      action.vx, …
In CSV the first row has all of them; the rows after it leave s0 and task empty.
In JSON: {"s0": {"x": 0.0, …}, "task": {…}, "action": {"vx": [1.0, …], …}}.

examples
  python -m study.run forecast --cell uav/high/residual_vae/seed-0 --scenario 17 --samples 200
  python -m study.run forecast --cell uav/high/residual_vae/seed-0 --scenario 17 --write plan.csv
  python -m study.run forecast --cell uav/low/full_vae/seed-0 --file plan.csv --save plan.rrd""",
    "verify": """\
checks   every file against SHA256SUMS; every recording against its own checksum; claims, tables
         and figures against those that the scores give when they are drawn again
--rerun  the test set is drawn again too, unless work/ holds it. The same machine gives the same
         scores; another may round differently: a score over all scenarios may differ by 0.001
         (the tables print three digits), and of those of single scenarios 1 % by more
exit     0 if all is as it was written, 1 if something differs

examples
  python -m study.run verify results/paper
  python -m study.run verify results/paper --rerun uav/high/residual_vae/seed-0""",
    "join": """\
Every file is checked first, and nothing is trained: tables, figures, claims and the recording of
the study are made anew from the scores of all seeds.

examples
  python -m study.run all --config configs/paper.yaml --grid.seeds '[0]' --out results/one
  python -m study.run all --config configs/paper.yaml --grid.seeds '[1, 2]' --out results/two
  python -m study.run join results/one results/two --out results/both""",
}

HELP = """usage: python -m study.run COMMAND [--config FILE] [--out DIR] [--any.setting VALUE]

{commands}

  --config FILE      settings; configs/quick.yaml if not given (also: smoke, paper, ablations)
  --out DIR          where results go; results/NAME if not given
  --only PATTERN     some cells only: 'pusher/high/*', '*/residual_vae/*'
  --kind KIND        view: which of a cell's recordings, forecast (default), scores, training or
                     tuning; `view pusher` opens the environment's data, `view study` every
                     cell's curves, tables and claims together
  --save DIR         view: no window; pictures of every view go to this folder
  --to DIR           portrait: folder of the page; export: folder of Minari data sets
  (forecast, verify and join read all settings in the results folders: forecast --help and so on)

examples
  python -m study.run all
  python -m study.run plan --config configs/paper.yaml
  python -m study.run all --only 'uav/low/*' --tune.trials 12 --engine.workers 2
  python -m study.run view study
  python -m study.run view pusher/low/residual_vae/seed-0 --kind scores --save pictures
  python -m study.run compare uav/low/residual_vae/seed-0 uav/low/full_vae/seed-0
  python -m study.run forecast --cell uav/high/residual_vae/seed-0 --scenario 17 --samples 200
  python -m study.run verify results/quick --rerun uav/high/residual_vae/seed-0
  python -m study.run ablate --config configs/ablations.yaml
  python -m study.run ablate --ablations '[vae.decoder_output=mean, vae.latent_size=2]'

`python -m study.run all --help` lists every setting.
"""


def usage() -> str:
    """The text of ``python -m study.run --help``."""
    width = max(map(len, COMMANDS))
    return HELP.format(commands="\n".join(f"  {c:{width}}  {t}" for c, t in COMMANDS.items()))
