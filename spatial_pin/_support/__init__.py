"""What every room needs: checks of arguments, short forms, tables, files, progress, executors."""
