"""A plugin that cannot be used is one line that says where and why."""

import re
from pathlib import Path

import pytest

from study.common.errors import BadInput
from study.common.plugins import import_plugins

HEAD = "from study.models import Model, models\nfrom study.envs import Simulator, register\n"
MODULES = {
    "syntax": ("def f(:\n", r"cannot import '{}': invalid syntax \(.*{}\.py, line 1\)"),
    "undefined": ("x = 1\ny = z\n", r"cannot import '{}': NameError: .* \(.*{}\.py, line 2\)"),
    "missing": ("import nowhere_to_be\n", "cannot import '{}': No module named 'nowhere_to_be'"),
    "exits": ("raise SystemExit(3)\n", "cannot import '{}': SystemExit: 3"),
    "nul": (  # Python before 3.11.4 raises a ValueError, and no SyntaxError
        "x = '\0'\n",
        "cannot import '{}': (ValueError: )?source code string cannot contain null bytes",
    ),
    "no_model": (
        HEAD + "@models.register('mine')\nclass Mine: pass\n",
        r"{}\.Mine is not a subclass of study\.models\.Model",
    ),
    "no_simulator": (
        HEAD + "@register('mine')\nclass Mine: pass\n",
        r"{}\.Mine is not a subclass of study\.envs\.Simulator",
    ),
    "lacks_of_a_model": (
        HEAD + "@models.register('mine')\nclass Mine(Model): pass\n",
        r"{}\.Mine lacks settings_class, sample, losses: see study\.models\.Model",
    ),
    "lacks_of_a_simulator": (
        HEAD + "@register('mine')\nclass Mine(Simulator):\n    name = title = 'mine'\n",
        r"{}\.Mine lacks state, action, goal, .*, policy, .*: see study\.envs\.Simulator",
    ),
    "ours": (
        "from study.models import models\nfrom study.models.residual_vae import ResidualVae as R\n"
        "@models.register('residual_vae')\nclass ResidualVae(R): pass\n",
        r"{}\.ResidualVae: study\.models\.residual_vae\.ResidualVae is already registered",
    ),
    "reserved": (
        "from study.models import models\nfrom study.models.full_vae import FullVae\n"
        "@models.register('oracle')\nclass Mine(FullVae): pass\n",
        r"{}\.Mine: 'oracle' cannot name a model",
    ),
    "same_title": (
        HEAD + "from study.examples.cart import Cart\n"
        "@register('cart_2')\nclass Mine(Cart): name = 'cart_2'\n",
        r"{}\.Mine: study\.examples\.cart\.Cart has the title 'Cart'",
    ),
    "other_name": (
        HEAD + "from study.examples.cart import Cart\n"
        "@register('cart_3')\nclass Mine(Cart): title = 'Cart 3'\n",
        r"{}\.Mine\.name: got 'cart'; it is registered as 'cart_3'",
    ),
    "no_bounds": (
        HEAD + "from study.examples.cart import Cart\nfrom study.envs import Variable\n"
        "@register('cart_4')\nclass Mine(Cart):\n    name = title = 'cart_4'\n"
        "    action = (Variable('force', 'N', 'push'),)\n",
        r"{}\.Mine\.action: 'force' is between -inf and inf; it needs two finite bounds",
    ),
    "no_horizon": (
        HEAD + "from study.examples.cart import Cart\n"
        "@register('cart_5')\nclass Mine(Cart):\n    name = title = 'cart_5'\n"
        "    default_horizon = 0\n",
        r"{}\.Mine\.default_horizon: got 0; it must be a positive whole number",
    ),
}


@pytest.mark.parametrize("kind", MODULES)
def test_a_broken_module(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content, error = MODULES[kind]
    name = f"broken_{kind}"
    (tmp_path / f"{name}.py").write_text(content)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(BadInput) as caught:
        import_plugins([name])
    line = str(caught.value)
    assert re.match("plugins: " + error.replace("{}", name), line), line
    assert "\n" not in line


@pytest.mark.parametrize("name", ["", "a/b", "my.py", ".relative", "a b", "../up", "a..b"])
def test_a_name_that_is_no_module(name: str) -> None:
    with pytest.raises(BadInput, match=re.escape(f"plugins: '{name}' is no module")):
        import_plugins([name])
