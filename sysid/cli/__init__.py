"""The command ``thinshell``: one file a subcommand, each a thin layer over a library function."""
