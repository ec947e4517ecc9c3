"""The discrete model: blocks, springs and contacts that break one by one.

A map of the modules, in the order in which they build on each other within each group.

The uniform chain, one slider: everything rests on its two modes.
    `modes`             the Green's function: two modes, and their reflection at the ends
    `front`             the first precursor by a recursion of fixed-size state: its one step, the loop, the record
    `delayed`           the same with contacts that repin after a delay
    `smooth`            the same with the smooth break rule; and that rule in a rupture of any chain
    `precursor`         what users call: the length, and the full record
    `sensitivity`       the derivative in the threshold and prestress of every contact
    `readings`          slip and stress along the interface, as gauges would read them

A block under two-dimensional elasticity on the same contacts.
    `waveguide`         the response of any uniform waveguide on attached contacts; the slider is one of two freedoms
    `elements`          a block as such a guide: graded columns of finite elements
    `blocks`            its first precursor: any contacts, in any order

The same front in closed form (the series itself is `slippulse_jax.double_series`).
    `crossing`          the search for where the front stress first falls to the threshold
    `exact`             what users call: length, record, stress and fields
    `crack`             the crack-like front, whose contacts slide until it stops

Many sliders at once. A *lane* is one slider of a batch; its result depends on it alone. How lanes are cut, padded and spread
over cores is a matter of `slippulse_jax.bulk`.
    `lanes`             the front for lanes: chunks that advance in step
    `lengths`           what users call: ℓ by the million
    `exact_lanes`       the closed form by the million: ℓ*, ℓ of long fronts, and where the contact at the edge breaks again

Any chain: springs, contacts and thresholds may differ from site to site.
    `chain`             the chain, its state, and its O(N) elimination, site after site
    `equilibrium`       forces in balance, with derivatives
    `distribution`      contacts of many junctions, their force law and stability
    `response`          what a push and a break do to every contact, of any body
    `event`             break after break at a fixed load, of any body
    `rupture`           nucleation and one rupture, under the hard rule or a smooth one
    `events`            lengths of whole events, in which contacts break again
    `ageing`            thresholds that grow with age
    `catalogue`         the record of the events, and its files
    `series`            one event after another, as the load grows
    `inertia`           the chain with masses
"""
