"""Input and output: checks of arguments, files, text, and interrupts.

Public functions check their arguments by `arguments`, files are read through `input_files` and
written through `whole_files`, and displayed text is escaped by `escaping`.
"""
