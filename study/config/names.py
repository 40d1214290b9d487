"""Names of environments, levels and models in settings and folders, and their labels in text."""

ENVIRONMENTS = ("pusher", "uav")
FRACTIONS = {"low": 1.0, "high": 0.1}
"""The fraction of the training data at the paper's levels of epistemic uncertainty."""
LEVELS = tuple(FRACTIONS)
RESIDUAL, FULL, MLP = "residual_vae", "full_vae", "probabilistic_mlp"
MODELS = (RESIDUAL, FULL, MLP)
"""The models of the paper."""
RESIDUAL_CRPS, FULL_CRPS = "residual_crps", "full_crps"
CRPS_ENSEMBLE = "full_crps_ensemble"
RESIDUAL_ENSEMBLE, FULL_ENSEMBLE = "residual_vae_ensemble", "full_vae_ensemble"
MLP_ENSEMBLE = "probabilistic_ensemble"
BEYOND = (
    RESIDUAL_CRPS,
    FULL_CRPS,
    CRPS_ENSEMBLE,
    RESIDUAL_ENSEMBLE,
    FULL_ENSEMBLE,
    MLP_ENSEMBLE,
)
"""Models beyond the paper, with † in their labels."""
ORACLE, ENSEMBLE = "oracle", "ensemble"
CLIMATOLOGY, PERSISTENCE, ANALOGUES = "training_climatology", "persistence", "analogues"
FROM_DATA = (CLIMATOLOGY, PERSISTENCE, ANALOGUES)
"""References of a recorded system, which forecast from its training trajectories."""

LABELS = {
    "pusher": "Pusher",
    "uav": "UAV",
    "low": "low epistemic",
    "high": "high epistemic",
    RESIDUAL: "residual VAE",
    FULL: "full VAE",
    MLP: "probabilistic MLP",
    RESIDUAL_CRPS: "residual CRPS†",
    FULL_CRPS: "full CRPS†",
    CRPS_ENSEMBLE: "full CRPS ensemble†",
    RESIDUAL_ENSEMBLE: "residual VAE ensemble†",
    FULL_ENSEMBLE: "full VAE ensemble†",
    MLP_ENSEMBLE: "probabilistic ensemble†",
    ORACLE: "oracle",
    ENSEMBLE: "ensemble alone",
    # Choices of the multiverse.
    "beta": "β",
    "mlp_loss": "MLP loss",
}


def uncertainty(level: str) -> str:
    """`low epistemic uncertainty`, in text; of a level beyond the paper's, its label."""
    return f"{label(level)} uncertainty" if level in LEVELS else label(level)


def label(name: str) -> str:
    """The label of a name in text: of a new name, the name without underscores."""
    return LABELS.get(name, name.replace("_", " "))


def markdown(text: str) -> str:
    """Text of a user, such as a unit or the name of an outcome, as a cell of a Markdown table."""
    escaped = text.replace("&", "&amp;").replace("<", "&lt;")
    for character in "\\|*`":
        escaped = escaped.replace(character, f"\\{character}")
    return " ".join(escaped.split())
