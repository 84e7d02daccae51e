"""The host's side of any axis link: what is asked, streamed, stamped and logged, whatever the protocol."""
