"""The configurations on the page `study/data/README.md` are settings that can be used."""

import re
from pathlib import Path

import pytest

from study import data
from study.config import strict_yaml
from study.config.recorded import Recorded, recorded_of, register_recorded
from study.config.tree import config_of, flatten
from study.data.recorded.description import Description

PAGE = (Path(data.__file__).parent / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("block", BLOCKS, ids=["acrobot", "px4"])
def test_a_configuration_on_the_page_can_be_used(block: str) -> None:
    content = strict_yaml.parse(block)
    register_recorded(content)
    config = config_of(flatten(content))
    (name,) = config.grid.environments
    recorded = recorded_of(config, name)
    assert recorded is not None
    Description(name, recorded).check()
    assert Description(name, recorded).conditions


def test_every_setting_is_on_the_page() -> None:
    for name in Recorded.__dataclass_fields__:
        assert f"`{name}`" in PAGE
