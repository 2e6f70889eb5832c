#compdef spatial-pin
# Completion of spatial-pin; in ~/.zshrc, behind compinit: eval "$(spatial-pin completion zsh)"
_spatial_pin() {
    local kind=""
    local -a commands equals
    commands=(
@COMMANDS@
    )
    if (( CURRENT == 2 )); then
        _describe command commands
        return
    fi
    case "$words[2] $words[CURRENT-1]" in
@VALUES@
    esac
    if [[ -z $kind && $words[CURRENT] == -* ]]; then
        case "$words[2]" in
@FLAGS@
        esac
        return
    fi
    [[ -n $kind ]] || case "$CURRENT $words[2]" in
        @TAKING@)
            compadd -- @MECHANISMS@ ;;
        "3 completion") compadd -- @SHELLS@; return ;;
@PLACES@
    esac
    if [[ -n $kind && $words[CURRENT] != *=* ]]; then
        [[ $kind != *= ]] || equals=(-S "")
        compadd $equals -- ${(f)"$(spatial-pin @NAMES@ $kind "$words[3]" 2>/dev/null)"} && return
    fi
    _files
}
compdef _spatial_pin spatial-pin
