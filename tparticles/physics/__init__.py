"""Laws and emitters: frozen descriptions that own no memory. Laws carry their formula as a `@ti.func`."""
