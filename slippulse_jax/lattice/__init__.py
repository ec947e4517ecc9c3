"""The discrete model: blocks, springs and contacts that break one by one.

A map of the modules, in the order in which they build on each other within each group.

The uniform chain, one slider: everything rests on its two modes.
    `modes`             the Green's function: two modes, and their reflection at the ends
    `front`             the first precursor by a recursion of fixed-size state, on the relaxed interface
    `interface_front`   the same with prestress, varying thresholds, delayed repinning
    `surrogate`         the same with the smooth break rule
    `compiled`          these three, compiled for each configuration, with their derivatives
    `precursor`         what users call: the length, and the full record
    `sensitivity`       the derivative in the threshold and prestress of every contact

The same front in closed form (the series itself is `slippulse_jax.double_series`).
    `crossing`          the search for where the front stress first falls to the threshold
    `exact`             what users call: length, record, stress and fields
    `readings`          slip and stress along the interface, as gauges would read them

Many sliders at once. A *lane* is one slider of a batch; its result depends on it alone. The `lane_…` modules are the above
formulas written a second time, for speed: number by number, without Python objects inside the loops.
    `kernel`            a loop as one function, several results from one loop: what XLA does not do by itself
    `batch`             lanes of like length put together, in few fixed shapes, on every core
    `lane_modes`, `lanes`                   the recursion for lanes: modes by hand, and chunks that advance in step
    `long_fronts`       lengths ℓ of long fronts by that closed form
    `bulk`, `exact_lanes`                   what users call: ℓ and ℓ* by the million

Any chain: springs, contacts and thresholds may differ from site to site.
    `chain`             the chain, its state, and its O(N) elimination, site after site
    `equilibrium`       forces in balance, with derivatives
    `distribution`      contacts of many junctions, their force law and stability
    `response`          the load that one break transfers to every other contact
    `cascade`           break after break at a fixed load, stresses known block by block
    `rupture`           nucleation and one rupture, under the hard rule or a smooth one
    `ageing`            thresholds that grow with age
    `catalogue`         the record of the events, and its files
    `series`            one event after another, as the load grows
    `inertia`           the chain with masses
"""
