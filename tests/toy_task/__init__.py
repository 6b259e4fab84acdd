"""A task as small as can be, whole: it finds cells of the image that objects stand in.

Nothing outside this folder knows it but one line of a registry, which the test of it adds.
"""
