"""Input and output: checks of arguments, files, text, and interrupts.

Every public function checks what it is given by `arguments`, every file is read through
`input_files` and written through `whole_files`, and every text that is shown passes `escaping`.
"""
