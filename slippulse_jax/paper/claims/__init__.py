"""Measure the paper's claims, and judge each by a stated criterion.

Everything is computed on demand, at the parameters of the paper's Fig. 2 unless stated otherwise: H/λc = 25, k/K = 0.03,
ν = 0.3. Where a claim does not hold, the reason found is reported.
"""

from slippulse_jax.paper.claims.claim import FAILS as FAILS
from slippulse_jax.paper.claims.claim import HOLDS as HOLDS
from slippulse_jax.paper.claims.claim import WITHIN as WITHIN
from slippulse_jax.paper.claims.table import CLAIMS as CLAIMS
from slippulse_jax.paper.claims.table import Result as Result
from slippulse_jax.paper.claims.table import examine as examine
from slippulse_jax.paper.claims.table import page as page
from slippulse_jax.paper.claims.table import row as row
