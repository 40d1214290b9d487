"""The layout of views: all of them, once, and no empty cell of a grid."""

import pytest
import rerun.blueprint as rrb

from study.recording import blueprints


def views(node: rrb.Container | rrb.View) -> list[rrb.View]:
    """All views below a container, from left to right and from top to bottom."""
    if isinstance(node, rrb.View):
        return [node]
    return [view for child in node.contents for view in views(child)]


@pytest.mark.parametrize("count", range(1, 8))
def test_a_grid_has_no_empty_cell(count: int) -> None:
    plots = [blueprints.plot(str(number), ["/a"]) for number in range(count)]
    laid_out = blueprints.grid(plots, 2, "page")
    assert laid_out.name == "page"
    assert views(laid_out) == plots
    grids = [laid_out, *laid_out.contents]
    for grid in (node for node in grids if isinstance(node, rrb.Grid)):
        assert grid.grid_columns in (1, 2)
        assert len(list(grid.contents)) % grid.grid_columns == 0


def test_training_has_a_view_for_each_kind_of_metric_and_none_for_epochs() -> None:
    metrics = ["epoch", "loss", "loss/kl", "validation/member_0", "validation_score", "speed"]
    root = blueprints.training(metrics).root_container
    shown = {str(view.name): view for view in views(root) if isinstance(view, rrb.TimeSeriesView)}
    assert {name: view.contents for name, view in shown.items()} == {
        "Loss": ["/loss"],
        "Validation": ["/validation/member_0", "/validation_score"],
        "KL divergence [nat]": ["/loss/kl"],
        "Other": ["/speed"],
    }
