"""Operations on arrays of views and pictures; this folder imports only compute."""
