"""Kernels that travel as LLVM bitcode and become machine code through llvmlite alone, so that nobody waits for numba.

declare, memory     compiled functions and what they refer to, without importing numba
kernel, arrays      kernels: C functions, and those that Python calls with arrays
bitcode, sources    the files that come with mjslq, and whether they fit the sources
machine, symbols    from bitcode to machine code, kept on disk; where the functions it calls are found
emit                from Python functions to bitcode, by numba, where no file fits
build               the command that makes the files anew: `python -m mjslq.native.build`
"""
