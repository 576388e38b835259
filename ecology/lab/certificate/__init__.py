"""The certificate: published results reproduced and compared."""
