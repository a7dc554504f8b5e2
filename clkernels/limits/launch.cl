// The limit of all that is short: a kernel that does nothing. Its time is that of a launch.

kernel void launch(void)
{
}
