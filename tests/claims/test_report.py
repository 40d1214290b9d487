"""The report defines its terms, and contains every claim."""

import json
import re

import numpy as np
import pytest

from study.claims.claim import Rule
from study.claims.judge import CLAIMS, Outcome, Status, judge
from study.claims.report import to_json, to_markdown
from study.config.names import FULL
from tests.helpers.synthetic import scores

CHECK = next(claim for claim in CLAIMS if claim.id == "check-energy_score-oracle-uav")


def test_the_report_has_every_claim_and_defines_its_terms() -> None:
    report = to_markdown(judge(scores()))
    assert report.count("\n- **") == len(CLAIMS)
    assert "(figures/mmd_pusher.png)" in report
    terms = report[report.index("## Terms") : report.index("## Contrasts")]
    for term in (*Status, *Outcome, *(rule.value for rule in Rule)):
        assert term in terms
    defined = re.findall(r"^\| (.+?) \|", terms, re.MULTILINE)
    words = {word for entry in defined for word in entry.split(", ")}
    assert {"claim", "check", "contrast", "effect", "interval", "Scenarios", "Seeds"} <= words
    assert {"smallest effect of interest", "margin", "oracle", *Status} <= words


def test_the_json_report_has_every_claim() -> None:
    entries = json.loads(to_json(judge(scores())))
    assert [entry["id"] for entry in entries] == [claim.id for claim in CLAIMS]
    assert len({claim.id for claim in CLAIMS}) == len(CLAIMS)
    assert entries[0]["smallest_finding"]["effect"] == pytest.approx(0.05)


def test_an_infinite_score_is_text_in_the_report() -> None:
    table = scores()
    worst = (table.metric == "energy_score") & (table.model == FULL) & (table.scenario == 3)
    table.loc[worst, "value"] = np.inf
    found = judge(table, [CHECK])
    assert found[0].outcome is Outcome.REPRODUCED
    assert "inf" in [finding["effect"] for finding in json.loads(to_json(found))[0]["findings"]]
    assert "nan" not in to_markdown(found)
