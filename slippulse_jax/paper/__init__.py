"""The paper's figures and claims."""

from slippulse_jax.slider import Slider

FIG2 = Slider(25.0, 0.03, 0.3)
"""The slider of the paper's Fig. 2."""
