"""The paper's claims, each measured: what it says, what the model gives, and whether the two agree.

Everything is computed when it is asked for, at the parameters of the paper's Fig. 2 unless said otherwise: H/λc = 25, k/K = 0.03,
ν = 0.3. A claim that does not hold is reported with the reason found.
"""

from slippulse_jax.paper.claims.claim import FAILS as FAILS
from slippulse_jax.paper.claims.claim import HOLDS as HOLDS
from slippulse_jax.paper.claims.claim import WITHIN as WITHIN
from slippulse_jax.paper.claims.table import CLAIMS as CLAIMS
from slippulse_jax.paper.claims.table import Result as Result
from slippulse_jax.paper.claims.table import examine as examine
from slippulse_jax.paper.claims.table import page as page
from slippulse_jax.paper.claims.table import row as row
