"""Bodies: the effect of a push and a break on every contact.

A uniform slider has two modes, by which a front costs O(1) per break. Any body has a response, by which its contacts break in
any order. In the order in which they build on each other:

    `modes`             the Green's function of a slider: two modes, and their reflection at the ends
    `chain`             any chain: springs, contacts and thresholds may differ from site to site; its O(N) elimination
    `equilibrium`       forces of a chain in balance, with derivatives
    `response`          what a push and a break do to every contact: of a chain, of a matrix, of a slider
"""
