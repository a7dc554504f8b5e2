"""OpenCL: choose a device, build kernels, launch them, move arrays. No other folder imports pyopencl."""
