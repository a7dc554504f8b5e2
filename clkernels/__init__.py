"""The OpenCL C sources of lightdome; this file makes them part of the package."""
