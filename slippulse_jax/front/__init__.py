"""One pass of a front over a slider, under any break rule.

`front`             the recursion of fixed-size state: its one step, the loop, the run past the arrest
`arrest`            where and how a front ends: what the doors above call
`sensitivity`       the derivative in the threshold and prestress of every contact
`lanes`             the front for many sliders at once: chunks of lanes that advance in step
"""
