// The limit for short kernels: this one does nothing, so its time is that of a launch.

kernel void launch(void)
{
}
