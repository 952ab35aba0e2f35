"""The abstraction: for each cell and input a box of cells that holds every successor."""
