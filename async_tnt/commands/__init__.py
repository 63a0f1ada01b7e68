"""The commands of the program `async-tnt`, a module each."""
