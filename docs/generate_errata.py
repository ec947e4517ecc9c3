"""Write docs/errata.md: every erratum and difference, with numbers computed here and now."""

import sys
from pathlib import Path

# ruff: noqa: E501
import jax
import numpy as np

import slippulse_jax as sp
from slippulse_jax import theory


def page() -> str:
    """The page, as Markdown."""
    slider = sp.Slider(25.0, 0.03, 0.3)
    right, wrong = theory.appendix(slider), theory.frozen_stress(slider, 0.0, printed=True)
    # α_2 as the bracket is printed, ½[1 − (κ² − √D/κ_T²)], beside the one that solves cra08 and cra09
    printed_alpha = (1 - (slider.kappa**2 - slider.mode_splitting / slider.kappa_T**2)) / 2
    soft = sp.Slider(6.84029016, 3.56033954e-03, 0.297661153)
    tall = sp.Slider(75_000.0, 1 / (2.6 * 75_000), 0.3)
    # all lengths in one call, as rows H/λc, k/K, φ, ε at ν = 0.3 but for the soft slider: each shape would be compiled anew
    q = np.geomspace(1e-3, 1, 600)
    peak = [(height, x, 0, 0) for height in (10.0, 25.0, 50.0) for x in q]
    fig2 = [(25.0, 0.03, phi, 0) for phi in (0.4, 0.5, 0.6)] + [(25.0, 0.03, 0, eps) for eps in (-1e-3, 0, 1e-3, 1e-2)]
    rows = np.array([*peak, *fig2, (tall.height, tall.stiffness, 0, 0), (soft.height, soft.stiffness, 0.6085, 0)], float)
    poisson = np.append(np.full(len(rows) - 1, 0.3), soft.poisson)
    fronts = sp.exact_front(sp.Slider(rows[:, 0], rows[:, 1], poisson), sp.Interface(rows[:, 2], rows[:, 3]))
    lengths = np.asarray(fronts.length)
    runs, slope, tall_length, soft_count = (
        lengths[1800:1803],
        lengths[1803:1807],
        lengths[1807],
        int(fronts.contacts_broken[1808]),
    )
    fig2_length = slope[1]
    peaks = [f"{q[np.argmax(length)]:.3f}" for length in lengths[:1800].reshape(3, 600)]
    return f"""# Errata of the paper, and where this project differs

Every number on this page is computed by `docs/generate_errata.py`; a test holds the page to it. Labels are those of the
paper's LaTeX source. Parameters, unless said otherwise: Fig. 2, $H/\\lambda_c = 25$, $k/K = 0.03$, $\\nu = 0.3$.

## Errata

| Where | Printed | Correct | Check |
|---|---|---|---|
| below cra18 | $\\alpha_m = \\frac12[1 - (\\kappa^2 \\pm \\sqrt{{\\mathcal D}}/\\kappa_T^2)]$ | $\\frac12[1 - (\\kappa^2 \\pm \\sqrt{{\\mathcal D}})/\\kappa_T^2]$ | $\\alpha_2$: {float(printed_alpha):.2f} against {float(slider.alpha_2):.4f}, which is $1-\\kappa_2^2/\\kappa_T^2$ = {float(1 - (slider.kappa_2 / slider.kappa_T) ** 2):.4f} |
| cra45b, cra45c | $A_{{40}}+A_{{30}} = \\frac12\\beta U\\kappa/(\\kappa+\\kappa_2)$ | without the ½ | cra45d1 and cra45d2 follow only without it; $u(0) = u_s$ at $U_0$ = {float(right.U0):.4f} |
| cra54, cra54b | $-\\kappa(\\lambda_c\\kappa^2+\\kappa_2)/(\\kappa^2-\\kappa_2^2)$ in front of $e^{{-(\\kappa+\\kappa_2)s}}$ | $\\frac12\\kappa(1-\\lambda_c\\kappa)/(\\kappa+\\kappa_2)\\,(1/\\Psi_2-1)$ | $A_0$ = {float(wrong):.3f} printed: the front could not start; {float(right.A0):.4f} corrected; {float(theory.continuum_stress(slider, 0.0)):.4f} self-consistent |

The Appendix also writes $\\sigma$ for Poisson's ratio and $a$ for $\\lambda_c$. Eq. (25) is not touched by any of these.
`tests/test_theory.py` integrates the frozen equations (cra08–cra27) directly, without any $\\Psi$ or $A$, and finds the
corrected forms. Printed forms are to be had with `printed=True`.

## Differences of substance

| Claim | Found |
|---|---|
| Eq. (58) and Eq. (25) agree with the numerics | exact lattice {fig2_length:.3f} ({int(np.ceil(fig2_length))} contacts), self-consistent continuum {float(theory.length_continuum(slider)):.3f}, frozen continuum {float(theory.length_frozen(slider)):.3f}, Eq. (58) {float(right.length):.3f}, Eq. (25) {float(theory.length_eq25(slider)):.3f}: leaving out discreteness lengthens the front, freezing the slider shortens it, and the two nearly cancel |
| Eq. (25) holds for tall sliders | at $b = 1$ and $H/\\lambda_c = 75\\,000$: lattice $\\Lambda/H$ = {tall_length / 75_000:.4f}, macroscopic law {float(theory.macroscopic_length(1.0, 0.3)):.4f}, Eq. (25) {float(theory.length_eq25(tall)) / 75_000:.4f}: it freezes the upper layer |
| $\\Lambda$ grows with $k/K$ | it peaks at $k/K$ = {", ".join(peaks)} for $H/\\lambda_c$ = 10, 25, 50 and falls beyond |
| $\\Lambda(\\epsilon) \\approx \\Lambda(0)(1-\\epsilon)$ | with $\\sigma_s(i) = \\sigma_{{s0}}(1+\\epsilon i)$, $\\epsilon$ = −0.001, 0, 0.001, 0.01: {", ".join(f"{float(x):.2f}" for x in slope)}; the relative change is far larger than $\\epsilon$ per contact |
| beyond a Griffith threshold the front never stops | $\\varphi_c = (1+G_{{00}})/2$ = {float(theory.runaway_prestress(slider)):.4f}; at $\\varphi$ = 0.4, 0.5, 0.6: {", ".join(str(float(round(float(x), 2))) for x in runs)} |
| … for every slider | no: at $(6.84, 0.00356, 0.298)$, $\\varphi$ = 0.6085 exceeds $\\varphi_c$ = {float(theory.runaway_prestress(soft)):.4f} and the front still stops after {soft_count} contacts, because a soft interface lets the stress fall below the threshold near the edge, before it recovers: $\\varphi \\ge \\varphi_c$ is necessary, not sufficient |
"""


if __name__ == "__main__":
    with jax.enable_x64(True):
        text = page()
    if sys.argv[1:] == ["--check"]:
        sys.exit(text != (Path(__file__).parent / "errata.md").read_text(encoding="utf-8"))
    (Path(__file__).parent / "errata.md").write_text(text, encoding="utf-8")
