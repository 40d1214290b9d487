"""The sections of settings that the study's own models read.

They stand here and not beside the models, so that `plan`, `status` and ``--help`` need no torch.
"""

from dataclasses import dataclass

from study.config.sections import section, setting


@section("network")
@dataclass(frozen=True)
class Network:
    """The dynamics network of every model: see `study/models/networks/dynamics.py`.

    Args:
        features: a stem of products, sine and cosine of headings, residual layers, and a linear
            term of s_0 (`product`); or a GRU or an MLP of the inputs alone, as the paper's text
            reads (`none`).
    """

    features: str = setting("product", choices=("product", "none"))


@section("vae")
@dataclass(frozen=True)
class Vae:
    """The two recurrent conditional VAEs (section III-B).

    Args:
        hidden_size: units of the encoder's GRU, and of the decoder's stem, GRU and layers.
        latent_size: components of z_t.
        teacher_forcing: the decoder's state history in training: the true states (`always`), its
            own predictions (`never`), or the true states first and then its own (`scheduled`).
        target: the decoder's output is ε_{t+1} or s_{t+1} itself (`state`), or its change over
            the step (`delta`).
        decoder_output: a forecast state is sampled from p_θ(s_{t+1} | ·) (`sample`) or is its
            mean (`mean`).
        variance: that of p_θ depends on the past (`heteroscedastic`) or is one number for each
            dimension (`homoscedastic`).
        encoder: the encoder sees the target and s_t, a_t (`target`), or s_{0:t}, a_{0:t} alone as
            eq. (12) is written (`history`).
        member: m is sampled for each trajectory of a batch (`trajectory`) or once for all
            (`batch`).
    """

    hidden_size: int = setting(64, low=1, high=10**4)
    latent_size: int = setting(8, low=1, high=1000)
    teacher_forcing: str = setting("always", choices=("always", "never", "scheduled"))
    target: str = setting("delta", choices=("state", "delta"))
    decoder_output: str = setting("sample", choices=("sample", "mean"))
    variance: str = setting("heteroscedastic", choices=("heteroscedastic", "homoscedastic"))
    encoder: str = setting("target", choices=("target", "history"))
    member: str = setting("trajectory", choices=("trajectory", "batch"))


@section("crps")
@dataclass(frozen=True)
class Crps:
    """The CRPS generators: models trained by proper scores, beyond the paper.

    Args:
        hidden_size: units of the decoder's stem and of each of its layers.
        steps: of the optimiser, in place of `train.steps`.
        one_step_fraction: share of the steps that trains on single transitions, by the logarithmic
            score; the others train on autoregressive rollouts, by the CRPS.
        batch_size: trajectories that single transitions are sampled from, in place of
            `train.batch_size`; rollouts start from some of them.
        learning_rate: of AdamW at its peak, in place of `train.learning_rate`.
        symmetries: `all` or `none`, in place of `train.symmetries`.
        canonical_frame: with symmetries, a model without a baseline works in the canonical frame,
            if the system declares one (`study.data.symmetries.Turn`).
        noise_size: standard normal numbers that drive the decoder at each step.
        trajectory_latent_size: components of a latent variable of the whole trajectory, which
            stands for unobserved constants. An encoder of training trajectories finds it.
        trajectory_latent_weight: weight of its KL divergence.
        action_sum: the sum of all past actions is an input, for systems whose controller
            integrates an error.
        samples: forecasts of each training trajectory that are scored together.
        energy_weight: weight of the energy score of the joint state.
    """

    hidden_size: int = setting(96, low=1, high=10**4)
    steps: int = setting(3600, low=1, high=10**8)
    one_step_fraction: float = setting(0.97, low=0.0, high=1.0)
    batch_size: int = setting(64, low=1, high=10**6)
    learning_rate: float = setting(7e-3, low=1e-8, high=1.0)
    symmetries: str = setting("all", choices=("none", "all"))
    canonical_frame: bool = True
    noise_size: int = setting(12, low=1, high=1000)
    trajectory_latent_size: int = setting(1, low=0, high=1000)
    trajectory_latent_weight: float = setting(40.0, low=0.0)
    action_sum: bool = True
    samples: int = setting(4, low=2, high=10**4)
    energy_weight: float = setting(0.3, low=0.0)


@section("mlp")
@dataclass(frozen=True)
class Mlp:
    """The probabilistic MLP (section III-C).

    Args:
        hidden_size: units of each hidden layer.
        layers: number of hidden layers; the first is the stem.
        loss: the negative log-likelihood (`nll`), or the β-NLL (`beta_nll`), as for the VAEs: see
            `study/models/networks/likelihood.py`.
    """

    hidden_size: int = setting(128, low=1, high=10**4)
    layers: int = setting(3, low=1, high=100)
    loss: str = setting("beta_nll", choices=("nll", "beta_nll"))


@section("model_ensemble")
@dataclass(frozen=True)
class ModelEnsemble:
    """Ensembles of whole models, beyond the paper.

    Args:
        members: complete models, each with its own initial weights and order of the data.
    """

    members: int = setting(5, low=1, high=1000)


@section("probabilistic_ensemble")
@dataclass(frozen=True)
class ProbabilisticEnsemble:
    """The ensemble of probabilistic MLPs.

    Args:
        propagation: a forecast keeps its member for the whole trajectory (`trajectory`, TS∞), or
            samples one at every step (`step`, TS1).
    """

    propagation: str = setting("trajectory", choices=("trajectory", "step"))
