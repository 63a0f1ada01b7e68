"""What the commands share: options, output files, and commands in processes of their own."""
