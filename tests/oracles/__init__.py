"""Independent programs that check the package. None imports it, nor JAX; a test holds that.

(`derivation` is none of them: it writes out the steps of the paper's Appendix in the package's own formulas.)

=============== ============================================ ==========================================================
program         method                                       checks
=============== ============================================ ==========================================================
dense_chain     one dense matrix, solved after every break;  first precursor, its load and stresses, prestress, profiles,
                responses that carry complex steps           delay; equilibrium; ruptures and series with their energies,
                                                             ageing, spring; derivatives of ℓ; gauge readings
finite_elements one sparse matrix of a whole long block      response of a block, and the order of its breaks
lattice_mp      mpmath: modes from the 2 × 2 bulk matrix,    front stress between sites, ℓ* and its derivatives, tall
                break-by-break recursion, plain series       sliders, resonances; the macroscopic law's and the
                (60–100 digits); the continuum's series,     continuum's lengths, Eq. (58)
                and quadrature under a frozen upper slider
leapfrog        NumPy, the textbook's leapfrog               motion with inertia, damping and friction, and its energies
sliding_chain   a banded solve for every contact that slides crack-like fronts, their lengths and fields
=============== ============================================ ==========================================================

`test_problems` checks them against each other.
"""
