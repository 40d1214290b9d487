"""What a dynamics network consists of."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Architecture:
    """What the network consists of.

    Attributes:
        inputs: I, the size of the inputs beside the state.
        width: units of the stem and of each layer, and of the memory.
        memory: whether there is a GRU.
        start: with memory, the size of what h_0 depends on beside s_0.
        product: whether the stem is a product, and headings are features. Without it, a network
            with memory has neither stem nor layers, and the stem of one without memory is a layer.
        layers: residual layers after the stem.
        linear_start: whether the output depends linearly on s_0; only with `product`.
        delta: whether the output is the state's change, in units of δ, or the state itself.
        canonical: whether states are seen, and changes predicted, in the canonical frame that the
            normalization declares, if it does. The other inputs may not depend on direction.
        networks: M, the number of independent networks that are computed together.
    """

    inputs: int
    width: int
    memory: bool
    start: int = 0
    product: bool = True
    layers: int = 2
    linear_start: bool = True
    delta: bool = True
    canonical: bool = False
    networks: int = 1

    @property
    def stem_size(self) -> int:
        """P."""
        return self.width if self.product or not self.memory else 0

    @property
    def memory_size(self) -> int:
        """H."""
        return self.width if self.memory else 0

    @property
    def layers_count(self) -> int:
        """L."""
        return self.layers if self.stem_size else 0
