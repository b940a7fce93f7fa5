"""The kernel language: texts of kernels, with the agreement between modules and the driver."""
