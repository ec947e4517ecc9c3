"""The result of a fit, and all that it tells.

In the order in which they build on each other:

`verdict`           whether the data determine each parameter, or why not
`changes`           inputs, bodies and models that would move the fit
`suggestions`       what to try next
`samples`           refits, or draws from the posterior
`predicted`         curves of lengths, and fields along the interface
`values`            fitted parameters as a report writes them
`remarks`           what to read before using the numbers
`report`            the report as text
`record`            the fit as JSON, and back
`result`            what a fit returns
"""
