"""The inner loops compiled for the processor, each beside the torch code that it takes the place of.

Imports from nothing here but `errors` and `status`.
"""
