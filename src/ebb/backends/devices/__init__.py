"""Backends for devices beside the processor: one way to compile, bind and launch kernels, for any of them."""
